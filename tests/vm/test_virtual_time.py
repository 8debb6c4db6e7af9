"""What can be claimed without tolerance for a busy machine: the shipped scenarios in virtual time, on both engines.

The figures of every stream are recorded as properties of the tests; ``tests/bench/repeat_virtual.py`` compares them
over many runs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from netlab.lab.results import RunResult
from netlab.pytest_plugin import MakeLab

pytestmark = pytest.mark.lab_clock("virtual")

TOPOLOGIES = Path(__file__).parents[2] / "topologies"
TOLERANCE_S = 0.0001

Run = Callable[..., RunResult]


@pytest.fixture
def run(make_lab: MakeLab, request: pytest.FixtureRequest) -> Run:
    """Run a shipped scenario to its end."""

    def _run(name: str, engine: str, *overrides: str) -> RunResult:
        result = make_lab(TOPOLOGIES / f"{name}.yaml", engine=engine, overrides=overrides).run()
        assert result.passed, result.report()
        for row in result.summary["streams"]:
            figures = {key: row["latency_s"][key] for key in ("p50", "p99")} | {"delivered": row["delivered"]}
            stream = f"{name}/{engine} {row['source']}>{row['destination']} {row['topic']}"
            request.node.user_properties.append((stream, json.dumps(figures)))
        return result

    return _run


def _latency_s(result: RunResult, topic: str) -> dict[str, float]:
    return dict(result.stream(topic)["latency_s"])


@pytest.mark.parametrize("engine", ["air", "netem"])
def test_on_a_good_wire_every_message_takes_the_delay_and_its_own_bits(run: Run, engine: str) -> None:
    result = run("pair", engine)
    for topic in ("telemetry", "commands"):
        latency_s = _latency_s(result, topic)
        assert 0.002 <= latency_s["p50"] <= latency_s["max"] < 0.002 + TOLERANCE_S
        assert result.stream(topic)["delivered"] == result.stream(topic)["sent"]


@pytest.mark.parametrize("engine", ["air", "netem"])
def test_after_an_outage_the_next_probe_brings_the_peer_back(run: Run, engine: str) -> None:
    result = run("outage", engine, "duration=9s", "events=[{at: 3s, outage: {between: [base, robot1], for: 4s}}]")
    (reconnect,) = result.summary["reconnects"]
    # A probe each 25 ms, its way and the answer's, then at most one interval of the 20 Hz telemetry and its own way.
    assert reconnect["delay_s"] <= 0.025 + 2 * 0.005 + 0.050 + 0.005 + TOLERANCE_S
    assert _latency_s(result, "telemetry")["p50"] < 0.005 + 2 * TOLERANCE_S


@pytest.mark.parametrize("engine", ["air", "netem"])
def test_telemetry_overtakes_bulk_at_a_bottleneck(run: Run, engine: str) -> None:
    result = run("bottleneck", engine, "duration=4s")
    latency_s = _latency_s(result, "telemetry")
    assert latency_s["p50"] < 0.030
    assert latency_s["p99"] < 0.060
    assert result.stream("bulk")["goodput_bps"] > 8e6


def test_seeded_losses_delay_single_messages_but_lose_none(run: Run) -> None:
    result = run("lossy", "air", "duration=3s")
    for topic in ("telemetry", "image"):
        assert result.stream(topic)["delivered"] == result.stream(topic)["sent"]
    assert _latency_s(result, "telemetry")["p50"] < 0.010 + 2 * TOLERANCE_S
    assert _latency_s(result, "telemetry")["p99"] > 0.020  # some were lost, and sent again


def test_unseeded_losses_are_within_their_bounds(run: Run) -> None:
    result = run("lossy", "netem", "duration=3s")
    for row in result.summary["links"]:
        sent, lost = row["frames"], row["lost"]
        margin = 3.9 * math.sqrt(0.05 * 0.95 / sent)  # 1 run of 10,000 is outside
        assert abs(lost / sent - 0.05) < margin, row
