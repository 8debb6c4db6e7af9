"""The way between each two of many places: through which ends of their edges, how long, with how many turns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from netlab.world.geometry import Flags, Floats, Indexes
from netlab.world.ways import Ways, corners, unit

_TIE = 1e-9
_ENDS = ((0, 0), (0, 1), (1, 0), (1, 1))  # of the one edge and of the other, by which a way may leave and enter
_AT_M = 1e-6  # a foot this near a point of the graph is at it


@dataclass(frozen=True, slots=True, eq=False)
class Routes:
    """P = N (N - 1) / 2 ways, ``one[p] < other[p]`` (or the single pair of two places).

    ``leave`` and ``enter`` are the points of the graph by which a way leaves the edge of its beginning and comes onto
    that of its end; without meaning on one and the same edge. ``out`` and ``back`` are unit directions (P, 3) along the
    tunnel, from either end towards the other. ``shares[k, p]`` is which part of way p lies in tunnels of section k.
    """

    one: Indexes
    other: Indexes
    same_edge: Flags
    leave: Indexes
    enter: Indexes
    length_m: Floats
    corners: Floats
    width_m: Floats
    height_m: Floats
    out: Floats
    back: Floats
    shares: Floats


def choose_routes(
    ways: Ways,
    points_m: Floats,
    edges: Indexes,
    ends: Indexes,
    feet_m: Floats,
    widths_m: Floats,
    heights_m: Floats,
    sections: Indexes,
) -> Routes:
    """Return the shortest way between every two of N places.

    Args:
        ways: The tables of the graph.
        points_m: Its points (V, 3).
        edges: Each place's edge (N,).
        ends: The two points of that edge (N, 2).
        feet_m: Each place's foot on it (N, 3).
        widths_m: Width of that edge's tunnel (N,).
        heights_m: Its height.
        sections: Its section.
    """
    one, other = _pairs(len(edges))
    same_edge = edges[one] == edges[other]
    to_ends = points_m[ends] - feet_m[:, None, :]  # (N, 2, 3)
    to_ends_m = np.sqrt(np.einsum("nsk,nsk->ns", to_ends, to_ends))
    lengths_m = np.stack(
        [to_ends_m[one, a] + ways.length_m[ends[one, a], ends[other, b]] + to_ends_m[other, b] for a, b in _ENDS]
    )
    # A place at one end of its edge belongs to the edge: of two equal lengths, the one that does not turn back there.
    own_m = np.stack([to_ends_m[one, a] + to_ends_m[other, b] for a, b in _ENDS])
    best = np.argmin(lengths_m - _TIE * own_m, axis=0)
    a, b = best // 2, best % 2
    leave, enter = ends[one, a], ends[other, b]
    apart = feet_m[other] - feet_m[one]
    apart_m = np.sqrt(np.einsum("pk,pk->p", apart, apart))
    turns, out, back = _turns(ways, points_m, leave, enter, to_ends[one, a], to_ends[other, b])

    def least(of_places: Floats, of_ways: Floats) -> Floats:
        between = np.where(same_edge, np.inf, of_ways[leave, enter])
        return np.minimum(np.minimum(of_places[one], of_places[other]), between)

    return Routes(
        one=one,
        other=other,
        same_edge=same_edge,
        leave=leave,
        enter=enter,
        length_m=np.where(same_edge, apart_m, lengths_m[best, np.arange(len(best))]),
        corners=np.where(same_edge, 0.0, turns),
        width_m=least(widths_m, ways.width_m),
        height_m=least(heights_m, ways.height_m),
        out=np.where(same_edge[:, None], unit(apart), out),
        back=np.where(same_edge[:, None], unit(-apart), back),
        shares=_shares(
            np.where(same_edge, 0.0, ways.section_m[:, leave, enter]),
            (sections[one], np.where(same_edge, apart_m, to_ends_m[one, a])),
            (sections[other], np.where(same_edge, 0.0, to_ends_m[other, b])),
        ),
    )


def _shares(between_m: Floats, *ends: tuple[Indexes, Floats]) -> Floats:
    """Of each way, the part in each section: lengths between points (K, P), and what its two ends add (P,) where.

    A way without length lies where it begins.
    """
    ways = np.arange(between_m.shape[1])
    for section, length_m in ends:
        between_m[section, ways] += length_m
    total_m = between_m.sum(axis=0)
    between_m[ends[0][0], ways] += total_m == 0.0
    shares: Floats = between_m / np.where(total_m == 0.0, 1.0, total_m)
    return shares


@cache
def _pairs(count: int) -> tuple[Indexes, Indexes]:
    one, other = np.triu_indices(count, 1)
    return one, other


def _turns(
    ways: Ways, points_m: Floats, leave: Indexes, enter: Indexes, to_leave: Floats, to_enter: Floats
) -> tuple[Floats, Floats, Floats]:
    """Turns on the ways, and the directions at their ends.

    A place at a point of the graph has no direction of its own and takes that of what follows, so that a robot on a
    junction is in no tunnel's way.
    """
    through = leave != enter
    first, last = ways.neighbour[leave, enter], ways.neighbour[enter, leave]
    into = np.where(through[:, None], unit(points_m[first] - points_m[leave]), 0.0)
    onto = np.where(through[:, None], unit(points_m[enter] - points_m[last]), 0.0)
    start, finish = _directions(to_leave), -_directions(to_enter)
    turns = np.where(
        through,
        corners(start, into) + ways.inner_corners[leave, enter] + corners(onto, finish),
        corners(start, finish),
    )
    return turns, _first_known(start, into, finish), -_first_known(finish, onto, start)


def _directions(vectors: Floats) -> Floats:
    lengths = np.sqrt(np.einsum("pk,pk->p", vectors, vectors))
    return unit(np.where((lengths > _AT_M)[:, None], vectors, 0.0))


def _first_known(*candidates: Floats) -> Floats:
    chosen = candidates[-1]
    for candidate in reversed(candidates[:-1]):
        chosen = np.where(np.any(candidate != 0.0, axis=1)[:, None], candidate, chosen)
    return chosen
