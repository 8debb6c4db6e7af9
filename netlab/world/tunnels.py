"""Tunnels as a file describes them, and the graph that their centre lines make where they meet.

Tunnels are joined where their centre lines come within ``JOINT_M`` of each other: end to end, end to side, or crossing.
The centre line lies on the floor; a tunnel is as wide and as high around it all along.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from netlab.world.geometry import Floats
from netlab.world.motion import Point
from netlab.world.walls import Section, Walls

#: Centre lines that come this close are joined; nearer points of one line are one point.
JOINT_M = 0.5


@dataclass(frozen=True, slots=True)
class Tunnel:
    """A polyline of at least two points in metres, with its cross-section (both above 0), and its walls if known."""

    name: str
    path: tuple[Point, ...]
    width_m: float
    height_m: float
    walls: Walls | None = None

    @property
    def section(self) -> Section:
        """What is the same all along it."""
        return Section(self.width_m, self.height_m, self.walls)


@dataclass(frozen=True, slots=True, eq=False)
class Graph:
    """Points where tunnels begin, bend, end or meet, and the straight edges between them."""

    points_m: Floats  # (V, 3)
    ends: tuple[tuple[int, int], ...]  # of each edge
    tunnels: tuple[int, ...]  # of each edge: its tunnel's number


@dataclass(frozen=True, slots=True)
class _Piece:
    """A straight piece of one tunnel, from vertex ``place`` to the next."""

    tunnel: int
    place: int
    a: Floats
    b: Floats

    def length_m(self) -> float:
        return float(np.linalg.norm(self.b - self.a))

    def at(self, share: float) -> Floats:
        return self.a + share * (self.b - self.a)

    def nearest(self, point: Floats) -> float:
        """The place nearest to ``point``, as a share of the length."""
        along = self.b - self.a
        squared = float(along @ along)
        return min(1.0, max(0.0, float((point - self.a) @ along) / squared)) if squared else 0.0

    def snapped(self, share: float) -> float:
        """A place that is very near an end is that end."""
        length_m = self.length_m()
        if share * length_m <= JOINT_M:
            return 0.0
        return 1.0 if (1.0 - share) * length_m <= JOINT_M else share


_Mark = tuple[int, float]  # (piece, share of its length)


def join_tunnels(tunnels: Sequence[Tunnel]) -> Graph:
    """Return the graph of these tunnels. The order of the tunnels decides ties only."""
    pieces = [
        _Piece(number, place, np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64))
        for number, tunnel in enumerate(tunnels)
        for place, (a, b) in enumerate(pairwise(tunnel.path))
    ]
    groups = _Groups()
    marks: list[set[float]] = [{0.0, 1.0} for _ in pieces]
    for (one, other), contacts in _contacts(pieces):
        for mark in contacts:
            marks[one].add(mark[0])
            marks[other].add(mark[1])
            groups.unite((one, mark[0]), (other, mark[1]))
    for index, (piece, following) in enumerate(pairwise(pieces)):
        if following.tunnel == piece.tunnel:
            groups.unite((index, 1.0), (index + 1, 0.0))
    return _graph(pieces, marks, groups)


def _graph(pieces: Sequence[_Piece], marks: Sequence[set[float]], groups: _Groups) -> Graph:
    numbers: dict[_Mark, int] = {}
    points: list[Floats] = []
    edges: dict[tuple[int, int], int] = {}

    def number_of(mark: _Mark) -> int:
        first = groups.first(mark)
        if first not in numbers:
            numbers[first] = len(points)
            points.append(pieces[first[0]].at(first[1]))
        return numbers[first]

    for index, piece in enumerate(pieces):
        chain = [number_of((index, share)) for share in sorted(marks[index])]
        for a, b in pairwise(chain):
            if a != b:
                edges.setdefault((min(a, b), max(a, b)), piece.tunnel)
    return Graph(np.array(points).reshape(-1, 3), tuple(edges), tuple(edges.values()))


def _contacts(pieces: Sequence[_Piece]) -> Iterator[tuple[tuple[int, int], list[tuple[float, float]]]]:
    """Pairs of pieces that touch, with the places where they do. Neighbours in one tunnel are joined anyway."""
    lows = np.array([np.minimum(piece.a, piece.b) for piece in pieces]) - JOINT_M
    highs = np.array([np.maximum(piece.a, piece.b) for piece in pieces])
    for one, piece in enumerate(pieces):
        near = np.all((lows[one] <= highs) & (lows <= highs[one]), axis=1)
        for other in (np.flatnonzero(near[one + 1 :]) + one + 1).tolist():
            following = pieces[other].tunnel == piece.tunnel and pieces[other].place == piece.place + 1
            contacts = [] if following else _touching(piece, pieces[other])
            if contacts:
                yield (one, other), contacts


def _touching(p: _Piece, q: _Piece) -> list[tuple[float, float]]:
    """Where two pieces come within ``JOINT_M``: at their ends, and where they cross."""
    candidates = [(share, q.nearest(p.at(share))) for share in (0.0, 1.0)]
    candidates += [(p.nearest(q.at(share)), share) for share in (0.0, 1.0)]
    if (crossing := _crossing(p, q)) is not None:
        candidates.append(crossing)
    close = [(s, t) for s, t in candidates if np.linalg.norm(p.at(s) - q.at(t)) <= JOINT_M]
    return list(dict.fromkeys((p.snapped(s), q.snapped(t)) for s, t in close))


def _crossing(p: _Piece, q: _Piece) -> tuple[float, float] | None:
    """The closest places of two pieces that are not parallel, if both lie inside.

    Source: the least-squares solution of a1 + s u = a2 + t v for two lines in space.
    """
    u, v, w = p.b - p.a, q.b - q.a, p.a - q.a
    uu, uv, vv, uw, vw = float(u @ u), float(u @ v), float(v @ v), float(u @ w), float(v @ w)
    determinant = uu * vv - uv * uv
    if determinant <= 1e-9 * uu * vv:
        return None
    s, t = (uv * vw - vv * uw) / determinant, (uu * vw - uv * uw) / determinant
    return (s, t) if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0 else None


class _Groups:
    """Marks that are one point; the first of a group, by piece and place, stands for it."""

    def __init__(self) -> None:
        self._parents: dict[_Mark, _Mark] = {}

    def first(self, mark: _Mark) -> _Mark:
        while (parent := self._parents.get(mark, mark)) != mark:
            mark = parent
        return mark

    def unite(self, a: _Mark, b: _Mark) -> None:
        one, other = sorted((self.first(a), self.first(b)))
        self._parents[other] = one
