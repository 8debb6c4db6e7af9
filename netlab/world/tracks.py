"""Where one node is at any time: straight pieces from point to point, exact at every time without adding up steps.

Two points at the same time are a jump: somebody put the node elsewhere.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import pairwise

from netlab.world.motion import Point


@dataclass(frozen=True, slots=True)
class State:
    """A node at one time; see :class:`netlab.world.geometry.Moment`."""

    position_m: Point
    heading_deg: float
    speed_mps: float
    travelled_m: float


class Track:
    """One node's path over time. Before the first point it stands there, after the last one too."""

    __slots__ = ("_headings_deg", "_speeds_mps", "active_from_s", "points_m", "times_s", "travelled_m")

    def __init__(
        self,
        times_s: tuple[float, ...],
        points_m: tuple[Point, ...],
        *,
        heading_deg: float | None = None,
        active_from_s: float = -math.inf,
    ) -> None:
        """``heading_deg`` holds until it moves; by default that of its first move, or 0.

        Raises:
            ValueError: No point, or times that fall.
        """
        if not times_s or len(times_s) != len(points_m) or any(b < a for a, b in pairwise(times_s)):
            raise ValueError("a track is points at times that do not fall")
        self.times_s = times_s
        self.points_m = points_m
        self.active_from_s = active_from_s
        travelled, headings, speeds = [0.0], [heading_deg], [0.0]
        for (t0, p), (t1, q) in pairwise(zip(times_s, points_m, strict=True)):
            moved_m = math.dist(p, q) if t1 > t0 else 0.0
            travelled.append(travelled[-1] + moved_m)
            turned = math.hypot(q[0] - p[0], q[1] - p[1]) > 0.0 and t1 > t0
            headings.append(math.degrees(math.atan2(q[1] - p[1], q[0] - p[0])) if turned else headings[-1])
            speeds.append(moved_m / (t1 - t0) if t1 > t0 else 0.0)
        first = next((heading for heading in headings if heading is not None), 0.0)
        self.travelled_m = tuple(travelled)
        self._headings_deg = tuple(first if heading is None else heading for heading in headings)
        self._speeds_mps = (*speeds, 0.0)

    def at(self, at_s: float) -> State:
        """The state at a scenario time; at the time of a jump, behind it."""
        after = bisect_right(self.times_s, at_s)
        if after == 0:
            return State(self.points_m[0], self._headings_deg[0], 0.0, 0.0)
        if after == len(self.times_s):
            return State(self.points_m[-1], self._headings_deg[-1], 0.0, self.travelled_m[-1])
        start_s, end_s = self.times_s[after - 1], self.times_s[after]
        share = (at_s - start_s) / (end_s - start_s)
        travelled_m = self.travelled_m[after - 1]
        travelled_m += share * (self.travelled_m[after] - travelled_m)
        position_m = between(self.points_m[after - 1], self.points_m[after], share)
        return State(position_m, self._headings_deg[after], self._speeds_mps[after], travelled_m)

    def until(self, at_s: float) -> tuple[list[float], list[Point]]:
        """Times and points up to a time, the last one being where the node is then (before a jump of that time)."""
        before = bisect_left(self.times_s, at_s)
        if before == len(self.times_s) or before == 0:
            position_m = self.points_m[max(0, before - 1)]
        else:
            start_s, end_s = self.times_s[before - 1], self.times_s[before]
            share = (at_s - start_s) / (end_s - start_s)
            position_m = between(self.points_m[before - 1], self.points_m[before], share)
        return [*self.times_s[:before], at_s], [*self.points_m[:before], position_m]

    def behind(self, distance_m: float) -> Track:
        """The track of a node that follows on the same path, ``distance_m`` (0 or more) behind along it.

        It waits at the beginning of the path until the other is that far ahead.
        """
        times_s = sorted({*self.times_s, *self._passing_times(distance_m)})
        points: list[tuple[float, Point]] = []
        for start_s, end_s in pairwise(times_s):
            from_m = max(0.0, self.at(start_s).travelled_m - distance_m)
            to_m = max(from_m, self.at(end_s).travelled_m - distance_m)
            piece = bisect_left(self.travelled_m, (from_m + to_m) / 2)
            points += [(start_s, self._on_piece(piece, from_m)), (end_s, self._on_piece(piece, to_m))]
        kept = list(dict.fromkeys(points)) or [(times_s[0], self.points_m[0])]
        return Track(tuple(time_s for time_s, _ in kept), tuple(point for _, point in kept))

    def _passing_times(self, distance_m: float) -> list[float]:
        """When this node is ``distance_m`` beyond each of its own points."""
        passing = []
        for target_m in {travelled_m + distance_m for travelled_m in self.travelled_m}:
            after = bisect_left(self.travelled_m, target_m)
            if 0 < after < len(self.travelled_m):
                done_m, goal_m = self.travelled_m[after - 1], self.travelled_m[after]
                share = (target_m - done_m) / (goal_m - done_m)
                passing.append(self.times_s[after - 1] + share * (self.times_s[after] - self.times_s[after - 1]))
        return passing

    def _on_piece(self, piece: int, travelled_m: float) -> Point:
        """The place on the path where ``travelled_m`` lie behind, on the piece that ends with point ``piece``."""
        if piece == 0:
            return self.points_m[0]
        start_m, end_m = self.travelled_m[piece - 1], self.travelled_m[piece]
        share = (travelled_m - start_m) / (end_m - start_m) if end_m > start_m else 1.0
        return between(self.points_m[piece - 1], self.points_m[piece], min(1.0, max(0.0, share)))


def between(p: Point, q: Point, share: float) -> Point:
    """The point at ``share`` (0..1) of the way from ``p`` to ``q``."""
    return (p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1]), p[2] + share * (q[2] - p[2]))
