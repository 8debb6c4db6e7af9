"""wnet's core against its goals in virtual time: distributions of reroute and reconnect, and the share of control.

On the network in memory of tests/wnet, so that no other load on the machine disturbs; the lab's own figures, with real
processes, are another benchmark's. ``TRIALS`` may be set in the environment.
"""

from __future__ import annotations

import os
import statistics
import sys
from itertools import count, islice
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.wnet import test_goals as goals
from tests.wnet import test_heal as heal
from tests.wnet.conftest import MeshNet

TRIALS = int(os.environ.get("TRIALS", "20"))


def line(title: str, values: list[float]) -> None:
    """Print one distribution, in milliseconds."""
    low, high = 1000 * statistics.median(values), 1000 * max(values)
    print(f"{title:52} {low:8.0f} {1000 * goals.p90(values):8.0f} {high:8.0f}", flush=True)


def connected_seeds(reach: float) -> list[int]:
    """The first seeds at which twenty scattered nodes are one team."""
    return list(islice((seed for seed in count() if heal.is_one_team(seed, reach)), TRIALS))


def main() -> None:
    """Print one line per case."""
    print(f"{'pause in ms, traffic at 20 Hz both ways':52} {'median':>8} {'p90':>8} {'max':>8}")
    for loss_ratio in (0.0, 0.05):
        for cut, title in (("relay", "relay silent"), ("a", "its link to a cut"), ("b", "its link to b cut")):
            pauses = [goals.reroute_s(MeshNet, seed, cut, loss_ratio) for seed in range(TRIALS)]
            line(f"{title}, {loss_ratio:.0%} loss per frame", pauses)
    line("three hops after 15 s without links", [goals.reconnect_s(MeshNet, seed) for seed in range(TRIALS)])
    for reach, title in ((0.35, "over hops"), (2.0, "all in reach")):
        seeds = connected_seeds(reach)
        found = [heal.heal_s(MeshNet, seed, reach) for seed in seeds]
        line(f"20 nodes {title} after 15 s without links", [first_s for first_s, _whole_s in found])
        line("  until all have routes to all", [whole_s for _first_s, whole_s in found])
    line("10 and 10 nodes meet: until all have routes", [heal.merge_s(MeshNet, s, 0.45) for s in connected_seeds(0.45)])
    for reach, title in ((0.35, "over hops"), (2.0, "all in reach")):
        share = goals.settled_share(MeshNet, reach)
        print(f"control of 20 settled nodes, {title}: {share:.2%} of a 6 Mbit/s channel")


if __name__ == "__main__":
    main()
