"""What virtual time costs: real seconds per second of scenario, and CPU per packet with where it goes.

    .venv/bin/python tests/bench/bench_vm.py

Each case runs twice, short and long, so that the box's and the lab's start do not count. CPU seconds are those of all
the box's processes and hold on a busy machine too; real seconds only on an idle one. A packet is one record of the
capture: a frame that passed an interface, in or out.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader

ROOT = Path(__file__).parents[2]
NO_QUESTIONS = ("--set", "expect=[]")  # without them and without a capture, no packet is recorded

EIGHT = """
name: eight
duration: 60s
generate: {shape: star, count: 8, name: n, node: {processes: [udp_mesh]}, link: {delay: 5ms}}
traffic:
""" + "".join(
    f"  - {{from: n{a}, to: n{b}, topic: telemetry, priority: 1, size: 200B, rate: 20Hz}}\n"
    for a, b in [(1, 2), *((number, 1) for number in range(2, 9))]
)


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one run: seconds on the host's clock, CPU seconds, packets in the capture."""

    real_s: float
    cpu_s: float
    packets: int

    def __sub__(self, other: Cost) -> Cost:
        return Cost(self.real_s - other.real_s, self.cpu_s - other.cpu_s, self.packets - other.packets)


def run(scenario: Path, engine: str, duration_s: int, *, capture: Path | None) -> Cost:
    """One run in virtual time."""
    words = ["--in", "vm", "--clock", "virtual", "--engine", engine, "--set", f"duration={duration_s}s", "--json"]
    words += [*NO_QUESTIONS, *(() if capture is None else ("--capture", str(capture)))]
    before, began_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    argv = [sys.executable, "-m", "netlab", "run", str(scenario), *words]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(argv)}: {done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(time.monotonic() - began_s, cpu_s, 0 if capture is None else packets(capture))


def packets(capture: Path) -> int:
    """Packet records of a capture."""
    with capture.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    return sum(count for channel, count in counts.items() if summary.channels[channel].topic.endswith("/packets"))


def measure(name: str, scenario: Path, engine: str, seconds: tuple[int, int], folder: Path) -> dict[str, object]:
    """Cost of the second of scenario and of the packet, with and without recording packets."""
    short_s, long_s = seconds
    with_capture = [run(scenario, engine, s, capture=folder / "c.mcap") for s in (short_s, long_s)]
    without = [run(scenario, engine, s, capture=None) for s in (short_s, long_s)]
    more, bare = with_capture[1] - with_capture[0], without[1] - without[0]
    span_s = long_s - short_s
    row: dict[str, object] = {
        "case": name,
        "engine": engine,
        "real_s_per_s": round(more.real_s / span_s, 2),
        "cpu_s_per_s": round(more.cpu_s / span_s, 2),
        "packets_per_s": round(more.packets / span_s),
        "cpu_ms_per_packet": round(more.cpu_s / more.packets * 1e3, 2),
        "of_that_recording_ms": round((more.cpu_s - bare.cpu_s) / more.packets * 1e3, 2),
        "start_cpu_s": round(with_capture[0].cpu_s - more.cpu_s / span_s * short_s, 1),
    }
    print(json.dumps(row), flush=True)
    return row


def main() -> int:
    """Measure and print one JSON object a case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--short", type=int, default=2)
    parser.add_argument("--long", type=int, default=12)
    options = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory(prefix="netlab-bench-") as name:
        folder = Path(name)
        eight = folder / "eight.yaml"
        eight.write_text(EIGHT)
        for engine in ("netem", "air"):
            measure("bottleneck", ROOT / "topologies/bottleneck.yaml", engine, (options.short, options.long), folder)
            measure("eight nodes at 20 Hz", eight, engine, (options.short, options.long), folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
