"""What discovery costs and how fast it is: 50 nodes in range of each other on a 6 Mbit/s channel, in virtual time.

Run: python tests/bench/bench_udp_mesh_discovery.py [runs]. Over 60 s each: all nodes started within a second, and a
settled team that a newcomer joins. Every frame of udp_mesh is counted (there is no other). A goal that is missed ends
it with exit code 1.
"""

from __future__ import annotations

import statistics
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from discovery_rig import Channel, join_delays_s

NODES = 50
PERIOD_S = 60.0
GOAL_SHARE = 0.01
GOAL_DELAY_S = 1.0


def cold_start(*, seed: int, nodes: int, loss_ratio: float) -> tuple[Channel, float]:
    """Start all nodes within a second; return the channel after a minute and the share of it that was busy."""
    channel = Channel(seed=seed, loss_ratio=loss_ratio)
    began_s = channel.now
    for at_s, number in sorted((channel.rng.random(), number) for number in range(nodes)):
        if channel.cores:
            channel.run(began_s + at_s)
        else:
            channel.now = began_s + at_s
        channel.add(f"robot{number:02}")
    channel.run(began_s + PERIOD_S)
    return channel, channel.airtime_s / PERIOD_S


def newcomer(channel: Channel) -> tuple[list[float], float, int]:
    """Let one more node join; return its delays, the busy share of the next minute, and how many it knows after 1 s."""
    channel.airtime_s = 0.0
    began_s = channel.now
    delays = join_delays_s(channel, "newcomer", within_s=5.0)
    known = sum(channel.knows("newcomer", name) for name in channel.cores)
    channel.run(began_s + PERIOD_S)
    return delays, channel.airtime_s / PERIOD_S, known


def main() -> int:
    """Print the table; return the exit code."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    is_met = True
    print(f"{NODES} nodes, 6 Mbit/s, {runs} runs each; goal: {GOAL_SHARE:.0%} of the channel, {GOAL_DELAY_S} s at p95")
    for loss_ratio in (0.0, 0.1, 0.3):
        starts, joins, delays, known = [], [], [], []
        for seed in range(1, runs + 1):
            channel, share = cold_start(seed=seed, nodes=NODES - 1, loss_ratio=loss_ratio)
            starts.append(share)
            own_delays, share, count = newcomer(channel)
            joins.append(share)
            delays += own_delays
            known.append(count)
        p95_s = sorted(delays)[int(0.95 * len(delays))]
        is_met &= max(starts) <= GOAL_SHARE and max(joins) <= GOAL_SHARE and p95_s <= GOAL_DELAY_S
        print(
            f"loss {loss_ratio:.0%}: channel busy, all start {statistics.median(starts):.2%} (worst {max(starts):.2%}),"
            f" one joins {statistics.median(joins):.2%} (worst {max(joins):.2%}); listed by the others p50 "
            f"{statistics.median(delays):.3f} s, p95 {p95_s:.3f} s, max {max(delays):.3f} s; "
            f"it knows {min(known)} of {NODES - 1} after 5 s"
        )
    print("all goals met" if is_met else "MISSED")
    return 0 if is_met else 1


if __name__ == "__main__":
    sys.exit(main())
