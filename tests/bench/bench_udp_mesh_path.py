"""What udp_mesh makes of a path, in virtual time: two cores over the lab's medium, several seeds, with the goals.

Latencies are above the base: one-way delay and the message's own serialisation. Utilisation is bulk payload over what
the link carries after headers. Nothing here depends on how busy this machine is; nothing says how fast the code is.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))

from mesh_rig import TELEMETRY, Rig, saturate

from netlab.medium.impairments import Impairment, RandomLoss
from udp_mesh.core.settings import TopicPolicy

SEEDS = int(os.environ.get("BENCH_ROUNDS", "3"))
TWICE = TopicPolicy(priority=1, redundancy=2)
STALL = ((5.0, 5.17),)
LONG_STALL = ((6.0, 6.3),)
SMALL_SOCKET_BYTES = 120_000  # a quarter of the window that the path takes


def hog(seed: int) -> tuple[tuple[float, float], ...]:
    """Return the stalls of a process on a machine that is too busy: again and again, 3 to 100 ms."""
    rng, stalls, at_s = Random(seed), [], 3.0
    while at_s < 12.0:
        at_s += rng.expovariate(1 / 0.2)
        stalls.append((at_s, at_s := at_s + 0.003 * (100 / 3) ** rng.random()))
    return tuple(stalls)


def link(rate_bps: float, delay_s: float, *, loss_ratio: float = 0.0, limit: int = 50) -> Impairment:
    loss = RandomLoss(loss_ratio) if loss_ratio else None
    return Impairment(rate_bps=rate_bps, delay_s=delay_s, loss=loss, limit_packets=limit)


HOGS = {"a": hog(1), "b": hog(2), "medium": hog(3)}
LARGE = {"bulk_bytes": 200_000}  # so that the window is full
SMALL_SOCKET = LARGE | {"stalls": {"b": LONG_STALL}, "socket_bytes": SMALL_SOCKET_BYTES}


@dataclass(frozen=True, slots=True)
class Row:
    """One path. Goals are None where there are none: least utilisation, most milliseconds above the base.

    ``gap_ms``: the longest time in which no bulk message arrived.
    """

    name: str
    link: Impairment
    utilisation: float | None = None
    p50_ms: float | None = None
    p99_ms: float | None = None
    gap_ms: float | None = None
    arguments: dict[str, Any] = field(default_factory=dict)


ROWS = (
    Row("10 Mbit/s, 20 ms", link(10e6, 0.02), 0.95, 2, 5),
    Row("  5 % loss", link(10e6, 0.02, loss_ratio=0.05), 0.88, None, 60),
    Row("  5 % loss, sent twice", link(10e6, 0.02, loss_ratio=0.05), 0.88, None, 10, arguments={"telemetry": TWICE}),
    Row("5 Mbit/s, 30 ms, 15 % loss", link(5e6, 0.03, loss_ratio=0.15, limit=200), 4.0 / 4.726, None, 102),
    Row("1 Mbit/s, 10 ms", link(1e6, 0.01), None, None, None),
    Row("2 Mbit/s, 100 ms", link(2e6, 0.1, limit=200), None, None, None),
    Row("a stands still for 170 ms", link(10e6, 0.02), gap_ms=320, arguments={"stalls": {"a": STALL}}),
    Row("b stands still", link(10e6, 0.02), gap_ms=320, arguments={"stalls": {"b": STALL}}),
    Row("the medium stands still", link(10e6, 0.02), gap_ms=320, arguments={"stalls": {"medium": STALL}}),
    Row("all do, 3 to 100 ms each time", link(10e6, 0.02), 0.6, gap_ms=400, arguments={"stalls": HOGS}),
    Row("20 Mbit/s, 100 ms", link(20e6, 0.1, limit=400), arguments=LARGE),
    Row("  b still for 300 ms", link(20e6, 0.1, limit=400), arguments=LARGE | {"stalls": {"b": LONG_STALL}}),
    Row("  its socket full meanwhile", link(20e6, 0.1, limit=400), 0.7, arguments=SMALL_SOCKET),
)


def measure(row: Row) -> bool:
    """Print a line; whether its goals are met."""
    arguments = {"bulk_bytes": 50_000, **row.arguments}
    runs = [saturate(row.link, seed=seed, duration_s=12.0, **arguments) for seed in range(1, SEEDS + 1)]
    excess = sorted(value for run in runs for value in run.excess_s)
    met = True

    def quantile(share: float) -> float:
        return 1e3 * excess[min(int(share * len(excess)), len(excess) - 1)]

    def text(value: float, goal: float | None, *, least: bool = False) -> str:
        nonlocal met
        if goal is None:
            return f"{value:8.2f}                "
        is_met = value >= goal if least else value <= goal
        met &= is_met
        return f"{value:8.2f} (goal {goal:6.2f}){' ' if is_met else '!'}"

    used = sum(run.utilisation for run in runs) / len(runs)
    bulk = text(100 * used, None if row.utilisation is None else 100 * row.utilisation, least=True)
    telemetry = f"{text(quantile(0.5), row.p50_ms)} {text(quantile(0.99), row.p99_ms)}"
    gap = text(1e3 * max(run.longest_bulk_gap_s for run in runs), row.gap_ms)
    drops = f"{sum(run.queue_drops for run in runs):5} {sum(run.rig.socket_drops for run in runs):6}"
    print(f"{row.name:29} {bulk} {telemetry} {gap} {drops}", flush=True)
    return met


def reconnects(loss_ratio: float, *, count: int = 20, outage_s: float = 15.0) -> list[float]:
    """Delay of the first message published after each restoration; telemetry at 20 Hz, 10 ms one way."""
    rig = Rig(seed=1)
    rig.shape(Impairment(rate_bps=20e6, delay_s=0.01, loss=RandomLoss(loss_ratio) if loss_ratio else None))
    rig.meet()
    published: dict[int, float] = {}

    def publish() -> None:
        number = rig.publish("a", "telemetry", 200, TELEMETRY)
        if number is not None:
            published[number] = rig.now

    rig.every(0.05, publish, until_s=1e9)
    delays = []
    for _ in range(count):
        rig.run(2 + rig.rng.random())
        rig.outage(active=True)
        rig.run(outage_s)
        rig.outage(active=False)
        restored_s = rig.now
        rig.run(2.0)
        fresh = [e.now for e in rig.delivered("b", "telemetry") if published[e.message_id] >= restored_s]
        delays.append(min(fresh, default=float("inf")) - restored_s)
    return sorted(delays)


def main() -> int:
    """Print the table; 1 if a goal was missed."""
    heads = ("bulk, % of the link", "telemetry p50, ms", "telemetry p99, ms", "longest gap of bulk, ms")
    print(f"{'path':29} " + " ".join(f"{head:24}" for head in heads) + " drops socket")
    met = [measure(row) for row in ROWS]
    for loss_ratio, goal_ms in ((0.0, 100), (0.1, 150)):
        delays = reconnects(loss_ratio)
        p90 = 1e3 * delays[int(0.9 * len(delays)) - 1]
        p50, most = 1e3 * delays[len(delays) // 2], 1e3 * delays[-1]
        met.append(p90 <= goal_ms)
        print(f"first telemetry after 15 s of silence, {100 * loss_ratio:.0f} % loss, {len(delays)} times: ", end="")
        print(f"p50 {p50:.0f} ms, p90 {p90:.0f} ms (goal {goal_ms}), max {most:.0f} ms")
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
