"""Tracks: exact positions at any time, followers, carried nodes, moves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.world.choreography import Choreography
from netlab.world.motion import Carried, Follow, Motion, MotionError, Move, Sampled, Walk, Waypoint
from netlab.world.terrain import TunnelMap
from netlab.world.tracks import Track
from netlab.world.tunnels import Tunnel
from netlab.world.world import World

TERRAIN = TunnelMap(
    [
        Tunnel("adit", ((0, 0, 0), (120, 0, 0)), 4.0, 3.0),
        Tunnel("drift", ((120, 0, 0), (120, 80, 0)), 3.0, 3.0),
    ]
)


def walk(*places: tuple[float, float], speed_mps: float = 2.0, pause_s: float = 0.0) -> Walk:
    return Walk(places[0], tuple(Waypoint(place, speed_mps, pause_s) for place in places[1:]))


def tracks(motions: dict[str, Motion], *moves: Move, terrain: TunnelMap | None = None) -> dict[str, Track]:
    return dict(zip(motions, Choreography(motions, moves, terrain).tracks(), strict=True))


def test_a_walk_goes_at_its_speed_and_pauses() -> None:
    track = tracks({"a": walk((0, 0), (10, 0), (10, 6), pause_s=3.0)})["a"]
    assert track.at(-1).position_m == (0, 0, 0)
    assert track.at(2.5).position_m == (5, 0, 0)
    assert track.at(2.5).speed_mps == 2
    assert track.at(6).position_m == (10, 0, 0)
    assert track.at(6).speed_mps == 0
    assert track.at(9).position_m == pytest.approx((10, 2, 0))
    assert track.at(9).heading_deg == pytest.approx(90)
    assert track.at(100).position_m == (10, 6, 0)
    assert track.at(100).travelled_m == 16


def test_a_node_looks_where_it_will_go_and_keeps_looking_where_it_went() -> None:
    track = tracks({"a": Walk((0, 0), (Waypoint((0, -5), 1.0),), pause_s=4.0)})["a"]
    assert track.at(1).heading_deg == pytest.approx(-90)
    assert track.at(1).speed_mps == 0
    assert track.at(50).heading_deg == pytest.approx(-90)
    assert tracks({"a": Walk((0, 0), heading_deg=30.0)})["a"].at(5).heading_deg == 30


def test_in_tunnels_a_walk_goes_around_the_corner() -> None:
    track = tracks({"a": walk((100, 0), (120, 20))}, terrain=TERRAIN)["a"]
    assert track.at(10).position_m == pytest.approx((120, 0, 0))
    assert track.at(15).position_m == pytest.approx((120, 10, 0))
    assert track.at(15).travelled_m == pytest.approx(30)


def test_a_follower_goes_where_its_leader_went() -> None:
    both = tracks({"tail": Follow("head", 5.0), "head": walk((100, 0), (120, 20))}, terrain=TERRAIN)
    assert both["tail"].at(2).position_m == (100, 0, 0)
    assert both["tail"].at(5).position_m == pytest.approx((105, 0, 0))
    assert both["tail"].at(12).position_m == pytest.approx((119, 0, 0))
    assert both["tail"].at(14).position_m == pytest.approx((120, 3, 0))
    assert both["tail"].at(100).position_m == pytest.approx((120, 15, 0))
    assert both["tail"].at(100).travelled_m == pytest.approx(35)


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9), st.integers(0, 3)), min_size=2, max_size=7),
    st.floats(0.0, 30.0),
    st.floats(0.0, 60.0),
)
def test_a_follower_is_its_distance_behind_along_the_path(
    places: list[tuple[int, int, int]], distance_m: float, at_s: float
) -> None:
    waypoints = tuple(Waypoint((x, y), 1.5, float(pause_s)) for x, y, pause_s in places[1:])
    both = tracks({"head": Walk(places[0][:2], waypoints), "tail": Follow("head", distance_m)})
    head, tail = both["head"].at(at_s), both["tail"].at(at_s)
    behind_m = max(0.0, head.travelled_m - distance_m)
    assert tail.travelled_m == pytest.approx(behind_m, abs=1e-6)
    when_s = next(
        t0 + (behind_m - d0) / (d1 - d0) * (t1 - t0) if d1 > d0 else t0
        for t0, d0, t1, d1 in zip(
            both["head"].times_s,
            both["head"].travelled_m,
            [*both["head"].times_s[1:], math.inf],
            [*both["head"].travelled_m[1:], math.inf],
            strict=True,
        )
        if d0 <= behind_m + 1e-9 and (behind_m <= d1)
    )
    assert tail.position_m == pytest.approx(both["head"].at(when_s).position_m, abs=1e-5)


def test_a_carried_node_lies_where_it_was_dropped_and_is_active_from_then() -> None:
    motions: dict[str, Motion] = {"beacon": Carried("a", 3.0), "spare": Carried("a"), "a": walk((0, 0), (20, 0))}
    both = tracks(motions)
    world = World(None, list(both.values()))
    assert both["beacon"].at(2).position_m == (4, 0, 0)
    assert both["beacon"].at(50).position_m == (6, 0, 0)
    assert world.moment(2.9).active.tolist() == [False, False, True]
    assert world.moment(3.0).active.tolist() == [True, False, True]
    assert world.moment(50).positions_m[1].tolist() == [20, 0, 0]


def test_a_move_puts_a_node_elsewhere_or_sends_it_there() -> None:
    motions: dict[str, Motion] = {"a": walk((0, 0), (100, 0)), "b": walk((0, 0), (100, 0))}
    both = tracks(motions, Move(10.0, "a", (60, 0)), Move(10.0, "b", (120, 40), speed_mps=4.0), terrain=TERRAIN)
    assert both["a"].at(9.999).position_m[0] == pytest.approx(19.998)
    assert both["a"].at(10).position_m == (60, 0, 0)
    assert both["a"].at(99).position_m == (60, 0, 0)
    assert both["a"].at(99).travelled_m == pytest.approx(20)
    assert both["b"].at(20).position_m == pytest.approx((60, 0, 0))
    assert both["b"].at(99).position_m == (120, 40, 0)
    assert both["b"].at(30).speed_mps == pytest.approx(4)


def test_moves_count_in_the_order_of_time() -> None:
    track = tracks({"a": Walk((0, 0))}, Move(9.0, "a", (9, 9)), Move(5.0, "a", (5, 5)))["a"]
    assert track.at(6).position_m == (5, 5, 0)
    assert track.at(10).position_m == (9, 9, 0)


def test_a_follower_jumps_where_its_leader_jumped() -> None:
    both = tracks({"a": walk((0, 0), (10, 0)), "b": Follow("a", 2.0)}, Move(3.0, "a", (50, 0), speed_mps=None))
    assert both["b"].at(50).position_m == (4, 0, 0)
    assert both["a"].at(50).position_m == (50, 0, 0)


def test_samples_are_joined_by_straight_lines() -> None:
    track = tracks({"a": Sampled((1.0, 3.0), ((0, 0), (4, 2)))})["a"]
    assert track.at(0).position_m == (0, 0, 0)
    assert track.at(2).position_m == (2, 1, 0)
    assert track.at(9).position_m == (4, 2, 0)


def test_rock_on_the_way_is_a_mistake_of_that_waypoint() -> None:
    with pytest.raises(MotionError, match=r"\[60, 20\] lies in the rock") as caught:
        tracks({"a": walk((0, 0), (100, 0), (60, 20))}, terrain=TERRAIN)
    assert (caught.value.node, caught.value.part, caught.value.index) == ("a", "waypoint", 1)


def test_circles_of_followers_are_named() -> None:
    motions: dict[str, Motion] = {"a": Follow("b", 1.0), "b": Carried("c"), "c": Follow("a", 1.0)}
    with pytest.raises(MotionError, match="circle: a -> b -> c -> a"):
        tracks(motions)


def test_positions_do_not_depend_on_what_was_asked_before() -> None:
    track = tracks({"a": walk((0, 0), (33, 7), (5, 5))})["a"]
    first = track.at(7.3)
    for at_s in np.linspace(0, 40, 400):
        track.at(float(at_s))
    assert track.at(7.3) == first
