"""How fast udp_mesh is, in real time: throughput, CPU per GB, small messages, cost of being idle, time to be ready.

Run: python tests/bench/bench_udp_mesh_speed.py [runs]. Needs namespaces (root, or user namespaces). Beside it, on the
same wire in the same minute: bare segmented UDP and TCP from the same interpreter, which show what the machine gives.
"""

from __future__ import annotations

import statistics
import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from udp_mesh_rig import Application, Host, cpu_s, hosts, resident_bytes

BULK_BYTES = 1_000_000
GOAL_BULK_BPS = 1.5e9
GOAL_WINDOW_3_BPS = 60e6
GOAL_IDLE_RATIO = 0.005
GOAL_RESIDENT_BYTES = 50e6
GOAL_READY_S = 0.3


@dataclass(frozen=True, slots=True)
class Throughput:
    """One transfer. CPU in seconds, of which the daemons' and the applications' parts."""

    payload_bytes: float
    elapsed_s: float
    messages: int
    cpu_s: dict[str, float]

    @property
    def rate_bps(self) -> float:
        """Payload bits per second."""
        return 8 * self.payload_bytes / self.elapsed_s

    def cpu_per_gb(self, who: str) -> float:
        """CPU seconds of one process per GB of payload."""
        return self.cpu_s[who] / self.payload_bytes * 1e9


def transfer(pair: list[Host], *, size_bytes: int, count: int, suffix: str = "") -> Throughput:
    """Send ``count`` messages from the first node's application to the second's."""
    a, b = pair
    receiver = Application(f"subscribe{suffix}", b.socket_path, count)
    sender = Application(f"publish{suffix}", a.socket_path, b.name, size_bytes, count)
    before, began_s = [cpu_s(host.pid) for host in pair], time.monotonic()
    sent, received = sender.result(), receiver.result()
    used = [cpu_s(host.pid) - spent for host, spent in zip(pair, before, strict=True)]
    cpu = {"app out": sent["cpu_s"], "daemon out": used[0], "daemon in": used[1], "app in": received["cpu_s"]}
    return Throughput(received["bytes"], received["ended_s"] - began_s, count, cpu)


def main(runs: int = 3) -> int:
    with hosts() as pair:
        for host in pair:
            print("ready", host.start())
        for _ in range(runs):
            for suffix in ("", "_async"):
                r = transfer(pair, size_bytes=BULK_BYTES, count=200, suffix=suffix)
                print(suffix, f"{r.rate_bps/1e6:.0f} Mbit/s", {k: round(r.cpu_per_gb(k), 2) for k in r.cpu_s})
        r = transfer(pair, size_bytes=100, count=3000)
        print(f"small {r.messages / r.elapsed_s:.0f}/s")
        print([resident_bytes(h.pid) / 1e6 for h in pair])
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
