"""From motions to tracks: who goes where and when, leaders and carriers before those that depend on them.

A walk goes straight to what is in line of sight and along the tunnels to what is not. Imported samples are joined by
straight lines. Times and places are those of exact lengths from the beginning of each leg.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

from netlab.world.motion import NEVER_S, Carried, Follow, Motion, MotionError, Move, OffTunnel, Point, Sampled, Walk
from netlab.world.tracks import Track

if TYPE_CHECKING:
    from netlab.world.terrain import TunnelMap


class Choreography:
    """All motions together; gives the track of each node, leaders and carriers first."""

    def __init__(self, motions: Mapping[str, Motion], moves: Sequence[Move], terrain: TunnelMap | None) -> None:
        """``moves`` of one node count in the order of their times."""
        self._motions = motions
        self._moves = sorted(enumerate(moves), key=lambda item: item[1].at_s)
        self._terrain = terrain
        self._tracks: dict[str, Track] = {}
        self._open: list[str] = []

    def tracks(self) -> list[Track]:
        """The tracks of all nodes in order.

        Raises:
            MotionError: A place in the rock, a way that does not exist, or nodes that wait for one another.
        """
        return [self.track(name) for name in self._motions]

    def track(self, node: str) -> Track:
        """The track of one node; raises as :meth:`tracks`."""
        if node in self._tracks:
            return self._tracks[node]
        if node in self._open:
            chain = " -> ".join((*self._open[self._open.index(node) :], node))
            raise MotionError(node, f"nodes follow or carry one another in a circle: {chain}")
        self._open.append(node)
        try:
            track = self._moved(node, self._own_track(node))
        finally:
            self._open.pop()
        self._tracks[node] = track
        return track

    def _own_track(self, node: str) -> Track:
        match self._motions[node]:
            case Walk() as walk:
                return self._walk(node, walk)
            case Follow(leader, distance_m):
                return self.track(leader).behind(distance_m)
            case Carried(carrier, deployed_at_s):
                return _carried(self.track(carrier), deployed_at_s)
            case Sampled(times_s, points_m):
                points = [self._place(node, point, "sample", index) for index, point in enumerate(points_m)]
                return Track(times_s, tuple(points))

    def _walk(self, node: str, walk: Walk) -> Track:
        path = _Path([0.0], [self._place(node, walk.start_m, "start", None)])
        path.wait(walk.pause_s)
        for index, waypoint in enumerate(walk.waypoints):
            goal = self._place(node, waypoint.position_m, "waypoint", index)
            path.go(self._way(node, path.points_m[-1], goal, "waypoint", index), waypoint.speed_mps)
            path.wait(waypoint.pause_s)
        return path.track(walk.heading_deg)

    def _moved(self, node: str, track: Track) -> Track:
        for index, move in self._moves:
            if move.node != node:
                continue
            goal = self._place(node, move.to_m, "move", index)
            path = _Path(*track.until(move.at_s))
            if move.speed_mps is None:
                path.jump(goal)
            else:
                path.go(self._way(node, path.points_m[-1], goal, "move", index), move.speed_mps)
            track = path.track(track.at(0.0).heading_deg, track.active_from_s)
        return track

    def _place(self, node: str, position_m: tuple[float, ...], part: str, index: int | None) -> Point:
        if self._terrain is None:
            return (position_m[0], position_m[1], position_m[2] if len(position_m) == 3 else 0.0)
        try:
            return self._terrain.locate(position_m)
        except OffTunnel as error:
            raise MotionError(node, str(error), part=part, index=index) from None

    def _way(self, node: str, start: Point, goal: Point, part: str, index: int) -> list[Point]:
        if self._terrain is None:
            return [start, goal]
        try:
            return self._terrain.way(start, goal)
        except OffTunnel as error:
            raise MotionError(node, str(error), part=part, index=index) from None


class _Path:
    """A track in the making."""

    def __init__(self, times_s: list[float], points_m: list[Point]) -> None:
        self._times_s = times_s
        self.points_m = points_m

    def wait(self, duration_s: float) -> None:
        if duration_s > 0:
            self._add(self._times_s[-1] + duration_s, self.points_m[-1])

    def jump(self, goal: Point) -> None:
        self._add(self._times_s[-1], goal)

    def go(self, way: Sequence[Point], speed_mps: float) -> None:
        """Follow ``way``, which begins here; the times are those of exact lengths from here on."""
        started_s, gone_m = self._times_s[-1], 0.0
        for p, q in pairwise(way):
            gone_m += math.dist(p, q)
            if p != q:
                self._add(started_s + gone_m / speed_mps, q)

    def track(self, heading_deg: float | None, active_from_s: float = -math.inf) -> Track:
        return Track(tuple(self._times_s), tuple(self.points_m), heading_deg=heading_deg, active_from_s=active_from_s)

    def _add(self, time_s: float, point: Point) -> None:
        self._times_s.append(time_s)
        self.points_m.append(point)


def _carried(carrier: Track, deployed_at_s: float) -> Track:
    if deployed_at_s == NEVER_S:
        return Track(carrier.times_s, carrier.points_m, active_from_s=NEVER_S)
    times_s, points_m = carrier.until(deployed_at_s)
    return Track(tuple(times_s), tuple(points_m), active_from_s=deployed_at_s)
