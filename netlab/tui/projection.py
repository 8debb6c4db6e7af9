"""From metres to the dots of the map, and places for nodes that have none. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from netlab.tui.braille import DOTS_X, DOTS_Y

Point = tuple[float, float]
#: (column, row)
Cell = tuple[int, int]
_LEAST_SPAN_M = 10.0
_MARGIN_CELLS = (4, 2)
_MORE_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Projection:
    """The same scale in both directions, y up; dots of most terminals are about square."""

    left_m: float
    top_m: float
    dots_per_m: float

    def dots(self, point_m: Point) -> Point:
        """Where a place is, in dots from the top left."""
        return (point_m[0] - self.left_m) * self.dots_per_m, (self.top_m - point_m[1]) * self.dots_per_m

    def cell(self, point_m: Point) -> Cell:
        """Its cell: (column, row)."""
        x, y = self.dots(point_m)
        return math.floor(x / DOTS_X), math.floor(y / DOTS_Y)

    def place(self, column: int, row: int) -> Point:
        """The place in the middle of a cell, metres."""
        x, y = (column + 0.5) * DOTS_X, (row + 0.5) * DOTS_Y
        return self.left_m + x / self.dots_per_m, self.top_m - y / self.dots_per_m


@dataclass(frozen=True, slots=True)
class Bounds:
    """The smallest upright rectangle around some points, metres."""

    left_m: float
    bottom_m: float
    right_m: float
    top_m: float

    @classmethod
    def of(cls, points_m: Iterable[Point]) -> Bounds:
        """Around points; without any, at (0, 0)."""
        points = list(points_m) or [(0.0, 0.0)]
        xs, ys = [x for x, _ in points], [y for _, y in points]
        return cls(min(xs), min(ys), max(xs), max(ys))

    def holds(self, other: Bounds) -> bool:
        """Whether nothing of the other one lies outside."""
        return self._joined(other) == self

    def widened(self, other: Bounds) -> Bounds:
        """Around both, and a bit more where the other one lies outside: who walks on does so for a while."""
        both = self._joined(other)
        more_m = _MORE_SHARE * max(both.right_m - both.left_m, both.top_m - both.bottom_m)
        return Bounds(
            both.left_m - more_m * (both.left_m < self.left_m),
            both.bottom_m - more_m * (both.bottom_m < self.bottom_m),
            both.right_m + more_m * (both.right_m > self.right_m),
            both.top_m + more_m * (both.top_m > self.top_m),
        )

    def _joined(self, other: Bounds) -> Bounds:
        return Bounds(
            min(self.left_m, other.left_m),
            min(self.bottom_m, other.bottom_m),
            max(self.right_m, other.right_m),
            max(self.top_m, other.top_m),
        )


def fit(bounds: Bounds, columns: int, rows: int) -> Projection:
    """The projection that shows all of it in so many cells, in the middle, with a margin around."""
    span_x = max(_LEAST_SPAN_M, bounds.right_m - bounds.left_m)
    span_y = max(_LEAST_SPAN_M, bounds.top_m - bounds.bottom_m)
    wide = max(1, columns - 2 * _MARGIN_CELLS[0]) * DOTS_X
    high = max(1, rows - 2 * _MARGIN_CELLS[1]) * DOTS_Y
    scale = min(wide / span_x, high / span_y)
    middle_x, middle_y = (bounds.right_m + bounds.left_m) / 2, (bounds.top_m + bounds.bottom_m) / 2
    return Projection(middle_x - columns * DOTS_X / 2 / scale, middle_y + rows * DOTS_Y / 2 / scale, scale)


def in_a_circle(names: Sequence[str]) -> dict[str, Point]:
    """Places for nodes of which nobody has said where they are: on an ellipse as wide as a screen."""
    count = max(1, len(names))
    return {
        name: (60.0 * math.cos(2 * math.pi * i / count + math.pi), 25.0 * math.sin(2 * math.pi * i / count + math.pi))
        for i, name in enumerate(names)
    }


def nearest(cell: Cell, cells: Mapping[str, Cell], *, within: float) -> str | None:
    """The name whose cell is nearest to ``cell``; a row counts as two columns."""
    best, best_distance = None, within
    for name, (column, row) in cells.items():
        distance = math.hypot(column - cell[0], 2 * (row - cell[1]))
        if distance <= best_distance:
            best, best_distance = name, distance
    return best


def distance_to_line(point: Point, a: Point, b: Point) -> float:
    """How far a point is from the piece of line between two others."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = dx * dx + dy * dy
    share = 0.0 if length == 0 else max(0.0, min(1.0, ((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / length))
    return math.hypot(point[0] - a[0] - share * dx, point[1] - a[1] - share * dy)
