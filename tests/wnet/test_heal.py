"""How soon a team of twenty is whole again: after an outage of all links at once, and where two halves meet."""

from __future__ import annotations

import math

import pytest

from tests.wnet.test_goals import GOAL_S, PING_S, p90, ping, places, resumed_s, scattered

HEAL_SEEDS, MERGE_SEEDS = (0, 2), (4, 20)
MERGE_GOAL_S = 1.0


def is_one_team(seed: int, reach: float) -> bool:
    """Whether twenty scattered nodes all reach all, over others at least."""
    first, *left = (place for _name, place in places(seed))
    reached = [first]
    for at in reached:
        reached += [place for place in left if math.dist(at, place) <= reach]
        left = [place for place in left if place not in reached]
    return not left


def heal_s(make_mesh_net, seed: int, reach: float) -> tuple[float, float]:
    """After 15 s in which twenty nodes had no link at all: how long until a frame has come from one corner to the other
    in the slower direction, and until all have routes to all."""
    net = scattered(make_mesh_net, seed, reach)
    net.run(10.0 + 5.0 * net.rng.random())
    assert net.all_known()
    west, *_, east = by_place(seed)
    ping(net, west, east)
    net.run(2.0 + net.rng.random())
    for path in net.paths.values():
        path.is_cut = True
    net.run(15.0)
    for path in net.paths.values():
        path.is_cut = False
    restored_s = net.now
    whole_s = until_whole_s(net)
    net.run(0.5)
    return resumed_s(net, (west, east), restored_s), whole_s


def merge_s(make_mesh_net, seed: int, reach: float) -> float:
    """How long after two teams of ten have come into reach of each other all have routes to all."""
    net = scattered(make_mesh_net, seed, reach)
    west = by_place(seed)[:10]
    between = [path for (a, b), path in net.paths.items() if (a[0] in west) != (b[0] in west)]
    for path in between:
        path.is_cut = True
    net.run(35.0)
    for path in between:
        path.is_cut = False
    return until_whole_s(net)


def by_place(seed: int) -> list[str]:
    """The names of scattered nodes, from west to east."""
    return [name for name, _place in sorted(places(seed), key=lambda node: node[1])]


def until_whole_s(net) -> float:
    """How long it takes until all have routes to all, to 50 ms; infinite if more than 3 s."""
    for step in range(1, 61):
        net.run(PING_S)
        if net.all_known():
            return step * PING_S
    return math.inf


@pytest.mark.parametrize("reach", [0.35, 2.0], ids=["over hops", "all in reach"])
def test_a_team_without_any_link_for_15_s_is_whole_soon_after(make_mesh_net, reach: float) -> None:
    found = [heal_s(make_mesh_net, seed, reach) for seed in HEAL_SEEDS]
    assert p90(first_s for first_s, _whole_s in found) <= GOAL_S, found
    assert p90(whole_s for _first_s, whole_s in found) <= GOAL_S, found


def test_two_teams_that_meet_are_one_soon_after(make_mesh_net) -> None:
    found = [merge_s(make_mesh_net, seed, 0.45) for seed in MERGE_SEEDS]
    assert p90(found) <= MERGE_GOAL_S, found
