"""How fast udp_mesh is, in real time: throughput, CPU per GB, small messages, cost of being idle, time to be ready.

Run: python tests/bench/bench_udp_mesh_speed.py [runs]. Needs namespaces (root, or user namespaces). Beside it, on
the same wire in the same minutes: bare segmented UDP and TCP from the same interpreter, which show what the machine
gives just then. Medians; a goal that is missed ends it with exit code 1.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from udp_mesh_rig import Application, Host, cpu_s, hosts, resident_bytes

BULK_BYTES = 1_000_000
SMALL_BYTES = 100
SEGMENT_BYTES = 1400
IDLE_S = 20.0
SETTLE_S = 3.0
BARE_S = 2.0
WHO = ("app out", "daemon out", "daemon in", "app in")


@dataclass(frozen=True, slots=True)
class Throughput:
    """One transfer: payload, time, messages that arrived and that the application was too slow for, CPU by process."""

    payload_bytes: float
    elapsed_s: float
    messages: int
    missed: int
    cpu_s: tuple[float, ...]

    @property
    def rate_bps(self) -> float:
        """Payload bits per second."""
        return 8 * self.payload_bytes / self.elapsed_s

    @property
    def cpu_per_gb(self) -> list[float]:
        """CPU seconds per GB of payload, by process."""
        return [used / self.payload_bytes * 1e9 for used in self.cpu_s]


@dataclass(slots=True)
class Table:
    """What is printed, and whether every goal was met."""

    met: bool = True

    def line(self, what: str, measured: str, goal: str = "", *, is_met: bool | None = None) -> None:
        """Print one line."""
        verdict = "" if is_met is None else ("met" if is_met else "MISSED")
        self.met &= is_met is not False
        print(f"{what:<44} {measured:>24}   {goal:<18} {verdict}", flush=True)


def transfer(pair: list[Host], *, size_bytes: int, count: int, suffix: str = "") -> Throughput:
    """Send ``count`` messages from the first node's application to the second's."""
    a, b = pair
    receiver = Application(f"subscribe{suffix}", b.socket_path, count)
    sender = Application(f"publish{suffix}", a.socket_path, b.name, size_bytes, count)
    before, began_s = [cpu_s(host.pid) for host in pair], time.monotonic()
    sent, received = sender.result(), receiver.result()
    daemons = [cpu_s(host.pid) - used for host, used in zip(pair, before, strict=True)]
    used = (sent["cpu_s"], *daemons, received["cpu_s"])
    missed = int(received["missed"])
    return Throughput(received["bytes"], received["ended_s"] - began_s, count - missed, missed, used)


def bare(pair: list[Host], kind: str) -> Throughput:
    """Send without udp_mesh: ``udp`` in segmented bursts, or ``tcp``."""
    a, b = pair
    receiver = Application(f"{kind}_receive", *([BARE_S] if kind == "udp" else []), enter=b.enter)
    sender = Application(f"{kind}_send", SEGMENT_BYTES if kind == "udp" else BULK_BYTES, BARE_S, enter=a.enter)
    received, sent = receiver.result(), sender.result()
    return Throughput(received["bytes"], received["elapsed_s"], 0, 0, (sent["cpu_s"], received["cpu_s"]))


def median_of(runs: int, measure: Callable[[], Throughput]) -> Throughput:
    """Return the run of median rate."""
    return sorted((measure() for _ in range(runs)), key=lambda run: run.rate_bps)[runs // 2]


def report_bulk(table: Table, what: str, run: Throughput, goal_bps: float = 0.0) -> None:
    """Print throughput, and what it cost."""
    goal = f">= {goal_bps / 1e6:.0f} Mbit/s" if goal_bps else ""
    is_met = run.rate_bps >= goal_bps if goal_bps else None
    missed = f", {run.missed} missed" if run.missed else ""
    table.line(what, f"{run.rate_bps / 1e6:.0f} Mbit/s{missed}", goal, is_met=is_met)
    names = WHO if len(run.cpu_s) == len(WHO) else ("out", "in")
    parts = ", ".join(f"{name} {cost:.2f}" for name, cost in zip(names, run.cpu_per_gb, strict=True))
    table.line("  CPU s/GB", f"{sum(run.cpu_per_gb):.2f}", f"({parts})")


def speed(table: Table, runs: int) -> None:
    """Throughput and rates between two nodes."""
    with hosts() as pair:
        for host in pair:
            host.start()
        report_bulk(table, "bare UDP, 1400 B, segmented", median_of(runs, lambda: bare(pair, "udp")))
        report_bulk(table, "bare TCP", median_of(runs, lambda: bare(pair, "tcp")))
        for suffix in ("", "_async"):
            what = f"1 MB messages, {'asyncio' if suffix else 'ordinary'} clients"
            run = median_of(runs, lambda s=suffix: transfer(pair, size_bytes=BULK_BYTES, count=300, suffix=s))  # type: ignore[misc]
            report_bulk(table, what, run, 1.5e9)
        small = median_of(runs, lambda: transfer(pair, size_bytes=SMALL_BYTES, count=3000))
        per_message_us = 1e6 * sum(small.cpu_s) / small.messages
        table.line(
            "100 B messages, each awaited",
            f"{small.messages / small.elapsed_s:.0f}/s",
            f"({per_message_us:.0f} us CPU each)",
        )
    with hosts(config="window = 3\n") as pair:
        for host in pair:
            host.start()
        run = median_of(runs, lambda: transfer(pair, size_bytes=BULK_BYTES, count=30))
        report_bulk(table, "1 MB messages, window 3", run, 60e6)


def idleness(table: Table, runs: int) -> None:
    """Ready time, memory and CPU of a daemon with four peers."""
    with hosts(5) as nodes:
        ready = []
        for _ in range(runs):
            for node in nodes:
                node.stop()
            ready += [node.start() for node in nodes]
        time.sleep(SETTLE_S)
        before = [cpu_s(node.pid) for node in nodes]
        time.sleep(IDLE_S)
        share = statistics.median((cpu_s(n.pid) - used) / IDLE_S for n, used in zip(nodes, before, strict=True))
        ready_s, size_bytes = statistics.median(ready), max(resident_bytes(node.pid) for node in nodes)
    table.line("ready after", f"{1e3 * ready_s:.0f} ms", "<= 300 ms", is_met=ready_s <= 0.3)
    table.line("idle with 4 peers", f"{100 * share:.2f} % of a core", "<= 0.5 %", is_met=share <= 0.005)
    table.line("resident", f"{size_bytes / 1e6:.1f} MB", "<= 50 MB", is_met=size_bytes <= 50e6)


def main(runs: int = 3) -> int:
    """Print the table."""
    table = Table()
    idleness(table, runs)
    speed(table, runs)
    return 0 if table.met else 1


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
