"""A system of tunnels: where a position lies in it, the way from one to another, how many positions lie to each other.

Theory. Distances are measured along centre lines, from the foot of one position to the foot of the other, on the
shortest way; what lies off the centre line counts only in so far as no distance is shorter than the straight line. Two
positions are in line of sight when the centre line between their feet stays within half the width, and half the height,
of the narrowest tunnel on the way from the straight line between the feet. So a robot comes out of sight some metres
behind a corner, the sooner the farther it is seen from.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from netlab.world.geometry import Flags, Floats, Geometry, Indexes
from netlab.world.motion import OffTunnel, Point
from netlab.world.places import CentreLines, Places
from netlab.world.routes import Routes, choose_routes
from netlab.world.tunnels import JOINT_M, Tunnel, join_tunnels
from netlab.world.ways import Ways


class TunnelMap:
    """Tunnels and their tables. Immutable."""

    def __init__(self, tunnels: Sequence[Tunnel]) -> None:
        """``tunnels`` must not be empty."""
        self.tunnels = tuple(tunnels)
        self._graph = join_tunnels(tunnels)
        self._ends: Indexes = np.array(self._graph.ends, dtype=np.intp).reshape(-1, 2)
        points_m = self._graph.points_m
        owners = [tunnels[number] for number in self._graph.tunnels]
        self._widths_m = np.array([tunnel.width_m for tunnel in owners])
        self._heights_m = np.array([tunnel.height_m for tunnel in owners])
        self.sections = tuple(dict.fromkeys(tunnel.section for tunnel in owners))
        self._section_of: Indexes = np.array([self.sections.index(tunnel.section) for tunnel in owners], dtype=np.intp)
        self._lines = CentreLines(
            points_m[self._ends[:, 0]], points_m[self._ends[:, 1]], self._widths_m, self._heights_m
        )
        self._ways = Ways(self._graph, self._widths_m, self._heights_m, self._section_of)

    def locate(self, position: Sequence[float]) -> Point:
        """Return a position [x, y] or [x, y, z] in space; without z it lies on the floor.

        Raises:
            OffTunnel: It lies in the rock; says which tunnel is nearest and how far.
        """
        x_m, y_m = position[0], position[1]
        z_m = position[2] if len(position) == 3 else self._lines.floor(x_m, y_m)
        place = self._lines.places(np.array([[x_m, y_m, z_m]]))
        if not place.inside[0]:
            tunnel = self.tunnels[self._graph.tunnels[int(place.edges[0])]]
            text = ", ".join(f"{value:g}" for value in position)
            raise OffTunnel(
                f"[{text}] lies in the rock; the nearest tunnel is '{tunnel.name}', whose centre line is "
                f"{place.gaps_m[0]:.1f} m away and which is {tunnel.width_m:g} m wide and {tunnel.height_m:g} m high"
            )
        return (x_m, y_m, z_m)

    def way(self, start: Point, goal: Point) -> list[Point]:
        """Return the points of the way between two places, with both: straight in line of sight, else on centre lines.

        Raises:
            OffTunnel: No tunnel leads there.
        """
        places = self._lines.places(np.array([start, goal]))
        routes = self._routes(places)
        if not np.isfinite(routes.length_m[0]):
            ends = " to ".join(f"[{point[0]:g}, {point[1]:g}]" for point in (start, goal))
            raise OffTunnel(f"no tunnel leads from {ends}; tunnels join where centre lines meet within {JOINT_M} m")
        if self._in_sight(places, routes)[0]:
            return [start, goal]
        between = self._graph.points_m[self._ways.points(int(routes.leave[0]), int(routes.enter[0]))]
        return [start, *((float(x), float(y), float(z)) for x, y, z in between), goal]

    def geometry(self, positions_m: Floats) -> Geometry:
        """How the positions (N, 3) lie to one another; one in the rock counts as on the nearest centre line."""
        count = len(positions_m)
        places = self._lines.places(positions_m)
        routes = self._routes(places)
        one, other = routes.one, routes.other
        seen = self._in_sight(places, routes)
        straight = positions_m[other] - positions_m[one]
        straight_m = np.sqrt(np.einsum("pk,pk->p", straight, straight))
        out = np.where(seen[:, None], straight, routes.out)
        back = np.where(seen[:, None], -straight, routes.back)
        bearing_deg = np.zeros((count, count))
        bearing_deg[one, other] = np.degrees(np.arctan2(out[:, 1], out[:, 0]))
        bearing_deg[other, one] = np.degrees(np.arctan2(back[:, 1], back[:, 0]))
        return Geometry(
            distance_m=_both_ways(routes, np.maximum(routes.length_m, straight_m), count, 0.0),
            corners=_both_ways(routes, np.where(seen, 0.0, routes.corners), count, 0.0),
            line_of_sight=_both_ways(routes, seen.astype(np.float64), count, 1.0) > 0.5,
            width_m=_both_ways(routes, routes.width_m, count, np.inf),
            height_m=_both_ways(routes, routes.height_m, count, np.inf),
            bearing_deg=bearing_deg,
            sections=self.sections,
            shares=_both_ways(routes, routes.shares, count, 0.0),
        )

    def _routes(self, places: Places) -> Routes:
        edges = places.edges
        return choose_routes(
            self._ways,
            self._graph.points_m,
            edges,
            self._ends[edges],
            places.feet_m,
            self._widths_m[edges],
            self._heights_m[edges],
            self._section_of[edges],
        )

    def _in_sight(self, places: Places, routes: Routes) -> Flags:
        """Whether the centre line between two feet stays near the straight line.

        No point of a line of length L between two points c apart is farther than sqrt(L^2 - c^2) / 2 from the straight
        line (an ellipse), so most pairs on one straight run need no closer look; the others are walked point by point.
        """
        start, chord = places.feet_m[routes.one], places.feet_m[routes.other] - places.feet_m[routes.one]
        squared = np.einsum("pk,pk->p", chord, chord)
        least_m = np.minimum(routes.width_m, routes.height_m)
        with np.errstate(invalid="ignore"):  # a way that is infinite is none
            seen: Flags = np.isfinite(routes.length_m) & (
                (routes.length_m**2 - squared <= least_m**2) | (routes.same_edge)
            )
        unsure = np.flatnonzero(~seen & np.isfinite(routes.length_m))
        swapped = routes.leave[unsure] > routes.enter[unsure]
        here = np.where(swapped, routes.enter[unsure], routes.leave[unsure])
        goal = np.where(swapped, routes.leave[unsure], routes.enter[unsure])
        while len(unsure):
            off = self._graph.points_m[here] - start[unsure]
            share = np.einsum("pk,pk->p", off, chord[unsure]) / np.maximum(squared[unsure], 1e-12)
            off = off - np.clip(share, 0.0, 1.0)[:, None] * chord[unsure]
            near = np.hypot(off[:, 0], off[:, 1]) <= routes.width_m[unsure] / 2.0
            near &= np.abs(off[:, 2]) <= routes.height_m[unsure] / 2.0
            arrived = here == goal
            seen[unsure[near & arrived]] = True
            on = near & ~arrived
            unsure, here, goal = unsure[on], here[on], goal[on]
            here = self._ways.onward(here, goal)
        return seen


def _both_ways(routes: Routes, values: Floats, count: int, itself: float) -> Floats:
    """Values (..., P) of pairs as symmetric matrices (..., N, N)."""
    matrix = np.full((*values.shape[:-1], count, count), itself)
    matrix[..., routes.one, routes.other] = values
    matrix[..., routes.other, routes.one] = values
    return matrix
