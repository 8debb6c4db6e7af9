"""Shortest ways between the points of a tunnel graph, all pairs at once: length, turns, narrowest place, neighbours.

Of equally short ways the first that the tables find counts, the same one in both directions.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from netlab.world.geometry import Floats, Indexes
from netlab.world.tunnels import Graph

#: A bend below this is none: a tunnel is never drawn quite straight.
LEAST_TURN_DEG = 20.0
_FULL_TURN_DEG = 90.0
_TIE_M = 1e-9


def unit(vectors: Floats) -> Floats:
    """Scale vectors (..., 3) to length 1; zero stays zero."""
    lengths = np.sqrt(np.einsum("...k,...k->...", vectors, vectors))
    scaled: Floats = vectors / np.where(lengths > 0.0, lengths, 1.0)[..., None]
    return scaled


def corners(before: Floats, after: Floats) -> Floats:
    """How much of a corner lies between unit directions (..., 3): angle / 90 degrees, at most 1, slight bends 0.

    A missing direction (zero) makes no corner.
    """
    cosines = np.einsum("...k,...k->...", before, after)
    known = np.einsum("...k,...k->...", before, before) * np.einsum("...k,...k->...", after, after) > 0.5
    angles_deg = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    counted = known & (angles_deg >= LEAST_TURN_DEG - 1e-9)
    turned: Floats = np.where(counted, np.minimum(angles_deg / _FULL_TURN_DEG, 1.0), 0.0)
    return turned


class Ways:
    """Tables [from point, to point], symmetric. ``length_m`` is inf where no way leads.

    ``inner_corners`` are the turns at the points strictly between. ``neighbour[a, b]`` is the first point after a on
    the way to b, -1 where there is none. ``section_m[k]`` is how much of the way lies in tunnels of section k.
    """

    def __init__(self, graph: Graph, widths_m: Floats, heights_m: Floats, sections: Indexes) -> None:
        """``widths_m``, ``heights_m`` and ``sections`` (numbers from 0) belong to the graph's edges."""
        self._points_m = graph.points_m
        self.length_m, self._following = _shortest(graph)
        first, last, turns, width_m, height_m = self._along(graph, widths_m, heights_m)
        upper = np.triu(np.ones_like(turns, dtype=bool))
        self.inner_corners = np.where(upper, turns, turns.T)
        self.width_m = np.where(upper, width_m, width_m.T)
        self.height_m = np.where(upper, height_m, height_m.T)
        self.neighbour: Indexes = np.where(upper, first, last.T)
        section_m = self._section_lengths(graph, sections)
        self.section_m = np.where(upper, section_m, section_m.transpose(0, 2, 1))

    def points(self, a: int, b: int) -> list[int]:
        """The points of the way from a to b, both included; empty where none leads."""
        if a > b:
            return self.points(b, a)[::-1]
        if a != b and self._following[a, b] < 0:
            return []
        chain = [a]
        while chain[-1] != b:
            chain.append(int(self._following[chain[-1], b]))
        return chain

    def onward(self, here: Indexes, goal: Indexes) -> Indexes:
        """The next points on the ways from ``here`` to ``goal``; for a walk that began at a lower number than it."""
        following: Indexes = self._following[here, goal]
        return following

    def _along(
        self, graph: Graph, widths_m: Floats, heights_m: Floats
    ) -> tuple[Indexes, Indexes, Floats, Floats, Floats]:
        """Walk every way from its end back: first and last neighbour, turns, width, height; by number of hops."""
        count = len(graph.points_m)
        following = self._following
        last = np.full((count, count), -1, dtype=np.intp)
        turns = np.zeros((count, count))
        width_m, height_m = np.full((count, count), np.inf), np.full((count, count), np.inf)
        for (a, b), width, height in zip(graph.ends, widths_m, heights_m, strict=True):
            width_m[a, b] = width_m[b, a] = width
            height_m[a, b] = height_m[b, a] = height
        edge_width_m, edge_height_m = width_m.copy(), height_m.copy()
        direct = following == np.arange(count)
        last[direct] = np.nonzero(direct)[0]
        for here, goal, step in self._outwards():
            into, out = self._direction(here, step), self._direction(step, following[step, goal])
            turns[here, goal] = corners(into, out) + turns[step, goal]
            last[here, goal] = last[step, goal]
            width_m[here, goal] = np.minimum(edge_width_m[here, step], width_m[step, goal])
            height_m[here, goal] = np.minimum(edge_height_m[here, step], height_m[step, goal])
        return following, last, turns, width_m, height_m

    def _section_lengths(self, graph: Graph, sections: Indexes) -> NDArray[np.float32]:
        count = len(graph.points_m)
        section_of = np.zeros((count, count), dtype=np.intp)
        lengths_m = np.zeros((int(sections.max(initial=-1)) + 1, count, count), dtype=np.float32)
        for (a, b), section in zip(graph.ends, sections, strict=True):
            section_of[a, b] = section_of[b, a] = section
        here, goal = np.nonzero(self._following == np.arange(count))
        lengths_m[section_of[here, goal], here, goal] = self.length_m[here, goal]
        for here, goal, step in self._outwards():
            lengths_m[:, here, goal] = lengths_m[:, step, goal]
            lengths_m[section_of[here, step], here, goal] += self.length_m[here, step]
        return lengths_m

    def _outwards(self) -> Iterator[tuple[Indexes, Indexes, Indexes]]:
        """All ways of more than one hop, the shorter ones first: (from, to, next point on the way)."""
        done = self._following == np.arange(len(self._following))
        left = (self._following >= 0) & ~done
        while left.any():
            here, goal = np.nonzero(left)
            step = self._following[here, goal]
            ready = done[step, goal]
            here, goal, step = here[ready], goal[ready], step[ready]
            yield here, goal, step
            done[here, goal] = True
            left[here, goal] = False

    def _direction(self, a: Indexes, b: Indexes) -> Floats:
        return unit(self._points_m[b] - self._points_m[a])


def _shortest(graph: Graph) -> tuple[Floats, Indexes]:
    """Lengths of the shortest ways, and the next point on each (-1: none). Source: Floyd, CACM 5(6) 1962, page 345."""
    count = len(graph.points_m)
    length_m = np.full((count, count), np.inf)
    following = np.full((count, count), -1, dtype=np.intp)
    np.fill_diagonal(length_m, 0.0)
    for a, b in graph.ends:
        length_m[a, b] = length_m[b, a] = np.linalg.norm(graph.points_m[a] - graph.points_m[b])
        following[a, b], following[b, a] = b, a
    for via in range(count):
        detour_m = length_m[:, via, None] + length_m[None, via, :]
        shorter = detour_m < length_m - _TIE_M
        length_m[shorter] = detour_m[shorter]
        following = np.where(shorter, following[:, via, None], following)
    return np.minimum(length_m, length_m.T), following
