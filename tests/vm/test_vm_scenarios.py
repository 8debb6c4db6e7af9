"""`netlab run --in vm`: a scenario in the box, seen from outside."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from netlab.traces.load import load_trace
from netlab.vm.kernels import Kernel

ROOT = Path(__file__).parents[2]


def _run(*arguments: str, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "netlab", "run", *arguments]
    return subprocess.run(words, capture_output=True, text=True, cwd=ROOT, timeout=timeout_s, check=False)


@pytest.mark.parametrize("engine", ["air", "netem"])
def test_in_virtual_time_every_message_takes_the_links_delay(built_kernel: Kernel, tmp_path: Path, engine: str) -> None:
    capture = tmp_path / "out" / "pair.mcap"
    done = _run(
        *(str(ROOT / "topologies" / "pair.yaml"), "--in", "vm", "--clock", "virtual", "--json"),
        *("--engine", engine, "--capture", str(capture)),
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["clock"], result["engine"], result["capture"]) == ("virtual", engine, str(capture))
    telemetry = result["streams"][0]["latency_s"]
    assert 0.0020 <= telemetry["p50"] <= telemetry["p99"] < 0.0022  # 2 ms and the frame's own 20 us at 100 Mbit/s
    assert len(load_trace(capture).published[0]) == 100


def test_a_seeded_run_is_the_same_run_again(built_kernel: Kernel) -> None:
    lossy = str(ROOT / "topologies" / "lossy.yaml")
    words = ("--in", "vm", "--clock", "virtual", "--json", "--engine", "air", "--set", "duration=2s")
    first, again, other = (
        json.loads(_run(lossy, *words, "--seed", str(seed), timeout_s=240).stdout) for seed in (1, 1, 2)
    )
    for row, row_again, row_other in zip(first["streams"], again["streams"], other["streams"], strict=True):
        assert row["latency_s"] == pytest.approx(row_again["latency_s"], abs=0.0001)
        assert row["latency_s"]["p99"] != pytest.approx(row_other["latency_s"]["p99"], abs=0.0001)


def test_a_mistake_shows_before_a_kernel_boots(tmp_path: Path) -> None:
    scenario = tmp_path / "bad.yaml"
    scenario.write_text("duration: 5\nnodes: {a: {}}\n")
    done = _run(str(scenario), "--in", "vm")
    assert done.returncode == 2
    assert done.stderr.startswith(f"{scenario}:1: duration: 5 has no unit")
    clock = _run(str(ROOT / "topologies" / "pair.yaml"), "--clock", "virtual")
    assert clock.returncode == 2
    assert "add --in vm" in clock.stderr
