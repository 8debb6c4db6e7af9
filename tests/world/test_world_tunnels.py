"""Distances, corners and line of sight in tunnels, against geometry done by hand."""

from __future__ import annotations

import itertools
import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.world.geometry import Geometry
from netlab.world.motion import OffTunnel
from netlab.world.terrain import TunnelMap
from netlab.world.tunnels import Tunnel, join_tunnels
from netlab.world.walls import MATERIALS
from netlab.world.world import open_field


def tunnel(name: str, *path: tuple[float, ...], width_m: float = 4.0, height_m: float = 3.0) -> Tunnel:
    return Tunnel(name, tuple((x, y, *(rest or (0.0,))) for x, y, *rest in path), width_m, height_m)


ADIT = tunnel("adit", (0, 0), (120, 0))
DRIFT = tunnel("drift", (120, 0), (120, 80), width_m=3.0)
CORNER = TunnelMap([ADIT, DRIFT])


def of(terrain: TunnelMap, *positions: tuple[float, float] | tuple[float, float, float]) -> Geometry:
    return terrain.geometry(np.array([terrain.locate(position) for position in positions]))


def test_distances_go_along_the_tunnels() -> None:
    geometry = of(CORNER, (20, 0), (120, 60), (50, 0))
    assert geometry.distance_m[0, 1] == pytest.approx(100 + 60)
    assert geometry.distance_m[0, 2] == pytest.approx(30)
    assert geometry.width_m[0, 1] == 3.0
    assert geometry.width_m[0, 2] == 4.0


def test_a_right_angle_is_one_corner_and_hides() -> None:
    geometry = of(CORNER, (20, 0), (120, 60))
    assert geometry.corners[0, 1] == pytest.approx(1.0)
    assert not geometry.line_of_sight[0, 1]


@pytest.mark.parametrize(
    ("turn_deg", "corners"), [(10, 0.0), (19, 0.0), (30, 1 / 3), (45, 0.5), (90, 1.0), (120, 1.0), (150, 1.0)]
)
def test_a_turn_counts_by_its_angle(turn_deg: float, corners: float) -> None:
    end = (100 + 50 * math.cos(math.radians(turn_deg)), 50 * math.sin(math.radians(turn_deg)))
    terrain = TunnelMap([tunnel("bend", (0, 0), (100, 0), end)])
    assert of(terrain, (0, 0), end).corners[0, 1] == pytest.approx(corners)


def test_each_kind_of_tunnel_has_its_share_of_the_way() -> None:
    coal = Tunnel("c", ((120, 80, 0), (160, 80, 0)), 3.0, 3.0, MATERIALS["coal"])
    again = Tunnel("again", ((160, 80, 0), (160, 0, 0)), 4.0, 3.0)  # of the same kind as the adit
    terrain = TunnelMap([ADIT, DRIFT, coal, again])
    geometry = of(terrain, (100, 0), (160, 60), (20, 0))
    assert geometry.sections == (ADIT.section, DRIFT.section, coal.section)
    # from x = 100 m: 20 m of the adit, 80 m of the drift, 40 m of coal, 20 m of another tunnel like the adit
    assert geometry.shares[:, 0, 1] == pytest.approx([40 / 160, 80 / 160, 40 / 160])
    assert geometry.shares[:, 1, 0] == pytest.approx([40 / 160, 80 / 160, 40 / 160])
    assert geometry.shares[:, 0, 2] == pytest.approx([1, 0, 0])


@given(st.lists(st.tuples(st.floats(0, 1), st.integers(0, 3)), min_size=2, max_size=5), st.integers(0, 2**16))
def test_the_shares_of_any_way_are_those_of_its_pieces(places: list[tuple[float, int]], seed: int) -> None:
    """Against the way's own points: each piece lies in the tunnel that has its middle."""
    rng = random.Random(seed)
    kinds = [tunnel("a", (0, 0), (60, 0)), tunnel("b", (60, 0), (60, 50), width_m=3.0)]
    kinds += [tunnel("c", (60, 50), (0, 40), width_m=2.0), tunnel("d", (0, 40), (0, 0), width_m=5.0)]
    rng.shuffle(kinds)
    terrain = TunnelMap(kinds)
    points = []
    for share, which in places:
        p, q = kinds[which].path
        points.append(tuple(p[axis] + share * (q[axis] - p[axis]) for axis in range(3)))
    geometry = terrain.geometry(np.array(points))
    for one, other in itertools.combinations(range(len(points)), 2):
        lengths = dict.fromkeys(terrain.sections, 0.0)
        for p, q in itertools.pairwise(terrain.way(points[one], points[other])):
            middle = [(a + b) / 2 for a, b in zip(p, q, strict=True)]
            owner = min(kinds, key=lambda kind: distance_to(kind, middle))
            lengths[owner.section] += math.dist(p, q)
        total = sum(lengths.values())
        if total > 5.0 and not geometry.line_of_sight[one, other]:
            assert geometry.shares[:, one, other] == pytest.approx([m / total for m in lengths.values()], abs=1e-4)
        assert geometry.shares[:, one, other].sum() == pytest.approx(1.0)


def distance_to(kind: Tunnel, point: list[float]) -> float:
    a, b = (np.array(end) for end in kind.path)
    along = b - a
    share = min(1.0, max(0.0, float((np.array(point) - a) @ along / (along @ along))))
    return float(np.linalg.norm(np.array(point) - a - share * along))


def test_who_stands_far_before_a_corner_sees_half_a_width_around_it() -> None:
    # The point (120, 0) is off the straight line from (0, 0) to (120, y) by 120 y / hypot(120, y): up to half of 3 m.
    assert of(CORNER, (0, 0), (120, 1.4)).line_of_sight[0, 1]
    assert not of(CORNER, (0, 0), (120, 1.6)).line_of_sight[0, 1]


def test_in_sight_there_is_no_corner_and_radiation_leaves_straight() -> None:
    geometry = of(CORNER, (119, 0), (120, 1))
    assert geometry.line_of_sight[0, 1]
    assert geometry.corners[0, 1] == 0
    assert geometry.bearing_deg[0, 1] == pytest.approx(45)
    assert geometry.bearing_deg[1, 0] == pytest.approx(-135)


def test_radiation_leaves_along_the_tunnel() -> None:
    geometry = of(CORNER, (20, 1), (120, 60))
    assert geometry.bearing_deg[0, 1] == pytest.approx(0)
    assert geometry.bearing_deg[1, 0] == pytest.approx(-90)


def test_a_slightly_bent_tunnel_is_in_sight_only_as_far_as_its_width_allows() -> None:
    # Two runs of 50 m at 10 degrees: their common point is 50 sin 5 deg = 4.36 m off the straight line.
    end = (50 + 50 * math.cos(math.radians(10)), 50 * math.sin(math.radians(10)))
    for width_m, seen in ((8.0, False), (9.0, True)):
        terrain = TunnelMap([tunnel("bend", (0, 0), (50, 0), end, width_m=width_m, height_m=9.0)])
        geometry = of(terrain, (0, 0), end)
        assert bool(geometry.line_of_sight[0, 1]) is seen
        assert geometry.corners[0, 1] == 0


def test_a_ramp_hides_by_its_height() -> None:
    terrain = TunnelMap([tunnel("ramp", (0, 0, 0), (50, 0, 0), (100, 0, 10), width_m=20.0, height_m=3.0)])
    geometry = of(terrain, (0, 0, 0), (100, 0, 10))
    assert not geometry.line_of_sight[0, 1]
    assert geometry.distance_m[0, 1] == pytest.approx(50 + math.hypot(50, 10))


@pytest.mark.parametrize(
    ("other", "points", "edges"),
    [
        (tunnel("end to end", (100, 0), (100, 50)), 3, 2),
        (tunnel("end to end, nearly", (100.3, 0.3), (100, 50)), 3, 2),
        (tunnel("into the side", (40, 0.4), (40, 50)), 4, 3),
        (tunnel("across", (40, -50), (40, 50)), 5, 4),
        (tunnel("along", (50, 0), (150, 0)), 4, 3),
        (tunnel("beside", (0, 2), (100, 2)), 4, 2),
        (tunnel("below", (40, -50, -5), (40, 50, -5)), 4, 2),
    ],
    ids=lambda value: value.name if isinstance(value, Tunnel) else "",
)
def test_tunnels_join_where_their_centre_lines_meet(other: Tunnel, points: int, edges: int) -> None:
    for order in ([tunnel("main", (0, 0), (100, 0)), other], [other, tunnel("main", (0, 0), (100, 0))]):
        graph = join_tunnels(order)
        assert (len(graph.points_m), len(graph.ends)) == (points, edges)


def test_two_tunnels_that_do_not_meet_are_infinitely_far_apart() -> None:
    terrain = TunnelMap([ADIT, tunnel("far", (0, 50), (100, 50))])
    geometry = of(terrain, (10, 0), (10, 50))
    assert geometry.distance_m[0, 1] == math.inf
    assert not geometry.line_of_sight[0, 1]
    with pytest.raises(OffTunnel, match=r"no tunnel leads from \[10, 0\] to \[10, 50\]"):
        terrain.way((10, 0, 0), (10, 50, 0))


def test_a_shaft_leads_down() -> None:
    terrain = TunnelMap([ADIT, tunnel("shaft", (60, 0, 0), (60, 0, -30)), tunnel("deep", (60, 0, -30), (160, 0, -30))])
    geometry = of(terrain, (0, 0), (60, 1, -20), (160, 0, -30))
    assert geometry.distance_m[0, 1] == pytest.approx(60 + 20)
    assert geometry.corners[0, 2] == pytest.approx(2)


def test_a_position_without_height_lies_on_the_floor() -> None:
    terrain = TunnelMap([tunnel("ramp", (0, 0, 0), (100, 0, 10))])
    assert terrain.locate((50, 1)) == pytest.approx((50, 1, 5))


def test_rock_is_named_with_the_nearest_tunnel_and_the_distance() -> None:
    with pytest.raises(OffTunnel, match=r"\[50, 10\] lies in the rock; .* 'adit', whose centre line is 10\.0 m away"):
        CORNER.locate((50, 10))
    assert CORNER.locate((50, 2)) == (50, 2, 0)


def test_a_way_is_straight_in_sight_and_along_the_centre_lines_else() -> None:
    assert CORNER.way((0, 1, 0), (100, -1, 0)) == [(0, 1, 0), (100, -1, 0)]
    assert CORNER.way((0, 1, 0), (120, 60, 0)) == [(0, 1, 0), (120, 0, 0), (120, 60, 0)]


def test_the_shorter_of_two_ways_counts() -> None:
    ring = TunnelMap([tunnel("ring", (0, 0), (100, 0), (100, 40), (0, 40), (0, 0))])
    geometry = of(ring, (50, 0), (10, 40))
    assert geometry.distance_m[0, 1] == pytest.approx(50 + 40 + 10)
    assert geometry.corners[0, 1] == pytest.approx(2)


def test_without_terrain_all_is_straight_and_in_sight() -> None:
    geometry = open_field(np.array([[0.0, 0, 0], [3, 4, 0]]))
    assert geometry.distance_m[0, 1] == 5
    assert geometry.line_of_sight.all()
    assert geometry.bearing_deg[1, 0] == pytest.approx(math.degrees(math.atan2(-4, -3)))


_PLACES = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 4), st.booleans()), min_size=2, max_size=8)


@given(_PLACES)
def test_geometry_is_symmetric_and_never_shorter_than_straight(places: list[tuple[int, int, bool]]) -> None:
    lines = [tunnel(f"h{k}", (0, 25 * k), (100, 25 * k)) for k in range(5)]
    lines += [tunnel(f"v{k}", (25 * k, 0), (25 * k, 100)) for k in range(5)]
    terrain = _grid(tuple(lines))
    positions = np.array([(25 * a + 7 * along, 25 * b, 0) for a, b, along in places], dtype=float)
    geometry = terrain.geometry(positions)
    for matrix in (geometry.distance_m, geometry.corners, geometry.line_of_sight, geometry.width_m):
        assert np.array_equal(matrix, matrix.T)
    straight = np.linalg.norm(positions[:, None] - positions[None, :], axis=2)
    taxicab = np.abs(positions[:, None] - positions[None, :]).sum(axis=2)
    assert (geometry.distance_m >= straight - 1e-9).all()
    inside = (positions[:, 0] % 25 == 0)[:, None] | (positions[:, 0] % 25 == 0)[None, :]
    assert geometry.distance_m[inside] == pytest.approx(taxicab[inside])
    assert np.isfinite(geometry.bearing_deg).all()


_GRIDS: dict[tuple[Tunnel, ...], TunnelMap] = {}


def _grid(lines: tuple[Tunnel, ...]) -> TunnelMap:
    if lines not in _GRIDS:
        _GRIDS[lines] = TunnelMap(lines)
    return _GRIDS[lines]
