"""Every promise on latency and reconnection in virtual time, beside the same run in real time; the daemons' cost.

Run: python tests/bench/bench_udp_mesh_clocks.py [outages]. Whole scenarios with real daemons and clients over `air`.
Virtual time judges: it hides slow code, and a busy machine. Real time shows whether the code keeps up: each p50 within
2 ms of virtual time's, and the processor seconds of each daemon. A goal that is missed in virtual time, or a p50
further off, ends it with exit code 1. Where it may (root), the lab in real time goes before all other processes. Needs
the box's kernel (`netlab vm build`). The outages (20) take 17 s each in real time.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

TOPOLOGIES = Path(__file__).parents[2] / "topologies"
P50_GOAL_S = 0.002
OUTAGE_S, BETWEEN_S = 15.0, 2.1
PAYLOAD_SHARE = 1363 / 1442  # of a frame that is full


@dataclass(frozen=True, slots=True)
class Goal:
    """``figure`` of a topic's stream (or of all reconnections), at most ``limit``, or at least for a rate."""

    topic: str
    figure: str
    limit: float


@dataclass(frozen=True, slots=True)
class Row:
    """A scenario and what it has to show."""

    name: str
    scenario: str
    goals: tuple[Goal, ...]


def bottleneck() -> Row:
    """10 Mbit/s, 20 ms one way, 50 packets, saturated; base 20.3 ms."""
    text = re.sub(r"(?s)expect:.*", "expect: []\n", (TOPOLOGIES / "bottleneck.yaml").read_text())
    text = text.replace("size: 200kB, rate: 8Hz", "size: 50kB, rate: 32Hz")  # an unfinished one hardly counts
    goals = (Goal("telemetry", "p50", 0.0223), Goal("telemetry", "p99", 0.0253), Goal("bulk", "bps", _bulk(10e6, 0.95)))
    return Row("10 Mbit/s, 20 ms, saturated", text, goals)


def lossy() -> Row:
    """The same at 5 % loss each way; ``alarm`` is sent twice."""
    goals = (Goal("telemetry", "p99", 0.0803), Goal("alarm", "p99", 0.0303), Goal("bulk", "bps", _bulk(10e6, 0.88)))
    return Row("the same, 5 % loss", (TOPOLOGIES / "lossy_bottleneck.yaml").read_text(), goals)


def far() -> Row:
    """5 Mbit/s, 60 ms round trip, 15 % loss each way."""
    goals = (Goal("telemetry", "p99", 0.1325), Goal("bulk", "bps", 4e6))
    return Row("5 Mbit/s, 60 ms, 15 % loss", (TOPOLOGIES / "lossy_far.yaml").read_text(), goals)


def outages(count: int, loss: str, limit_s: float) -> Row:
    """15 s of silence, over and over; telemetry at 20 Hz, 10 ms one way."""
    period_s = OUTAGE_S + BETWEEN_S
    # They begin at different phases of the traffic, of the beacons and of the probes.
    begin = [BETWEEN_S + index * period_s + 0.9 * (index * 0.381966 % 1) for index in range(count)]
    lines = [
        f"name: outages\nseed: 1\nengine: air\nduration: {BETWEEN_S + count * period_s + 1:.1f}s",
        "nodes:\n  base: {processes: [udp_mesh]}\n  robot1: {processes: [udp_mesh]}",
        f"links:\n  - {{between: [base, robot1], rate: 20mbit, delay: 10ms, loss: {loss}}}",
        "traffic:\n  - {from: robot1, to: base, topic: telemetry, priority: 1, size: 200B, rate: 20Hz}",
        "events:",
        *(f"  - {{at: {at:.3f}s, outage: {{between: [base, robot1], for: {OUTAGE_S:g}s}}}}" for at in begin),
        "",
    ]
    name = f"{count} outages of {OUTAGE_S:g} s, {loss} loss"
    return Row(name, "\n".join(lines), (Goal("", "reconnect p90", limit_s),))


def _bulk(rate_bps: float, share: float) -> float:
    return rate_bps * PAYLOAD_SHARE * share


def run(scenario: str, *, virtual: bool) -> dict[str, Any]:
    """Return what ``netlab run --json`` prints."""
    with TemporaryDirectory(dir=Path.cwd()) as folder:  # not below /tmp, which the box hides
        file = Path(folder) / "scenario.yaml"
        file.write_text(scenario)
        words = [sys.executable, "-m", "netlab", "run", str(file), "--engine", "air", "--json"]
        command = [*words, "--in", "vm", "--clock", "virtual"] if virtual else [*precedence(), *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    start = done.stdout.find("{")
    if done.returncode not in (0, 1) or start < 0:
        raise SystemExit(f"the lab did not run: {done.stderr[-2000:]}")
    result: dict[str, Any] = json.loads(done.stdout[start:])
    return result


def precedence() -> list[str]:
    """Return the words that make a command go before all else on this machine, which is not to be measured."""
    words = ["chrt", "--rr", "1"]
    try:
        granted = subprocess.run([*words, "true"], capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        granted = False
    return words if granted else []


def figure(result: dict[str, Any], goal: Goal) -> float:
    """Return one figure of a run, in seconds or bit/s; infinity for what never came."""
    if goal.figure == "reconnect p90":
        return reconnect_s(result, 0.9)
    stream = next(row for row in result["streams"] if row["topic"] == goal.topic)
    if goal.figure == "bps":
        return float(stream["goodput_bps"])
    value = stream["latency_s"][goal.figure] if stream["delivered"] == stream["sent"] else None
    return float("inf") if value is None else float(value)


def reconnect_s(result: dict[str, Any], share: float) -> float:
    """Return a quantile, by nearest rank, of the delays of all reconnections."""
    delays = sorted(float("inf") if row["delay_s"] is None else row["delay_s"] for row in result["reconnects"])
    return float(delays[max(0, -int(-share * len(delays) // 1) - 1)])


def medians(result: dict[str, Any]) -> dict[str, float]:
    """Return the p50 that both clocks have to agree on: of every stream that is not bulk, or of the reconnections."""
    reconnects = {"reconnect": reconnect_s(result, 0.5)} if result["reconnects"] else {}
    return reconnects | {row["topic"]: row["latency_s"]["p50"] for row in result["streams"] if row["topic"] != "bulk"}


def show(row: Row) -> bool:
    """Run a scenario by both clocks and print it; whether all goals are met."""
    virtual, real = run(row.scenario, virtual=True), run(row.scenario, virtual=False)
    print(row.name)
    met = True
    for goal in row.goals:
        value, beside = figure(virtual, goal), figure(real, goal)
        is_met = value >= goal.limit if goal.figure == "bps" else value <= goal.limit
        met &= is_met
        name = f"{goal.topic} {goal.figure}".strip()
        print(
            f"  {name:<22} virtual {_text(goal, value)}  real {_text(goal, beside)}  goal {_text(goal, goal.limit)}",
            end="",
        )
        print("  met" if is_met else "  MISSED")
    for topic, value in medians(virtual).items():
        beside = medians(real)[topic]
        is_near = abs(beside - value) <= P50_GOAL_S
        met &= is_near
        print(f"  {topic + ' p50':<22} virtual {1e3 * value:9.2f} ms  real {1e3 * beside:9.2f} ms", end="")
        print(f"  off by {1e3 * (beside - value):+.2f} ms{'' if is_near else '  TOO FAR'}")
    costs = [p for p in real["processes"] if p["process"] == "udp_mesh"]
    text = ", ".join(f"{p['node']} {p['cpu_s']:.2f} s, {p['max_rss_bytes'] / 1e6:.0f} MB" for p in costs)
    print(f"  daemons in {real['duration_s']:.0f} s of real time: {text}", flush=True)
    return met


def _text(goal: Goal, value: float) -> str:
    return f"{value / 1e6:5.2f} Mbit/s" if goal.figure == "bps" else f"{1e3 * value:9.2f} ms"


def main(count: int = 20) -> int:
    """Print all rows."""
    rows = [bottleneck(), lossy(), far(), outages(count, "0%", 0.1), outages(count, "10%", 0.15)]
    met = [show(row) for row in rows]
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
