"""From metres to the dots of the map, and places for nodes that have none. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from netlab.tui.braille import DOTS_X, DOTS_Y

Point = tuple[float, float]
_LEAST_SPAN_M = 10.0


@dataclass(frozen=True, slots=True)
class Projection:
    """The same scale in both directions, y up; dots of most terminals are about square."""

    left_m: float
    top_m: float
    dots_per_m: float

    def dots(self, point_m: Point) -> Point:
        """Where a place is, in dots from the top left."""
        return (point_m[0] - self.left_m) * self.dots_per_m, (self.top_m - point_m[1]) * self.dots_per_m

    def cell(self, point_m: Point) -> tuple[int, int]:
        """Its cell: (column, row)."""
        x, y = self.dots(point_m)
        return math.floor(x / DOTS_X), math.floor(y / DOTS_Y)

    def place(self, column: int, row: int) -> Point:
        """The place in the middle of a cell, metres."""
        x, y = (column + 0.5) * DOTS_X, (row + 0.5) * DOTS_Y
        return self.left_m + x / self.dots_per_m, self.top_m - y / self.dots_per_m


def fit(points_m: Iterable[Point], columns: int, rows: int, *, margin: tuple[int, int] = (4, 2)) -> Projection:
    """The projection that shows all points in so many cells, in the middle, with a margin (cells) around."""
    points = list(points_m) or [(0.0, 0.0)]
    xs, ys = [x for x, _ in points], [y for _, y in points]
    span_x, span_y = max(_LEAST_SPAN_M, max(xs) - min(xs)), max(_LEAST_SPAN_M, max(ys) - min(ys))
    wide = max(1, columns - 2 * margin[0]) * DOTS_X
    high = max(1, rows - 2 * margin[1]) * DOTS_Y
    scale = min(wide / span_x, high / span_y)
    middle_x, middle_y = (max(xs) + min(xs)) / 2, (max(ys) + min(ys)) / 2
    return Projection(middle_x - columns * DOTS_X / 2 / scale, middle_y + rows * DOTS_Y / 2 / scale, scale)


def in_a_circle(names: Sequence[str]) -> dict[str, Point]:
    """Places for nodes of which nobody has said where they are: on an ellipse as wide as a screen."""
    count = max(1, len(names))
    return {
        name: (60.0 * math.cos(2 * math.pi * i / count + math.pi), 25.0 * math.sin(2 * math.pi * i / count + math.pi))
        for i, name in enumerate(names)
    }


def nearest(cell: tuple[int, int], cells: Mapping[str, tuple[int, int]], *, within: float) -> str | None:
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
