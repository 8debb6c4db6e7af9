"""The map: tunnels, links by quality, nodes with their names. One widget, drawn row by row.

The tunnels are drawn once per size; links are drawn again only when one of them or a node has moved by a dot; a row is
made into segments only when its cells have changed.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.geometry import Region, Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from netlab.live.links import Grade, Link
from netlab.live.model import LiveModel, Tunnel
from netlab.tui import palette
from netlab.tui.braille import DOTS_X, DOTS_Y, Layer, Line, characters
from netlab.tui.projection import Point, Projection, distance_to_line, fit, in_a_circle, nearest

_ROCK_INK = 1
_ROUND_M = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_INKS = {Grade.OUT_OF_RANGE: 2, Grade.DOWN: 3, Grade.POOR: 4, Grade.FAIR: 5, Grade.GOOD: 6}
_CHOSEN_INK = 7
_COLOURS = {0: palette.TEXT, _ROCK_INK: palette.ROCK, _CHOSEN_INK: palette.CHOSEN} | {
    ink: palette.GRADES[grade] for grade, ink in _INKS.items()
}
_GAPS = {Grade.GOOD: 1, Grade.FAIR: 2, Grade.POOR: 3, Grade.DOWN: 5, Grade.OUT_OF_RANGE: 8}
Hollow = NDArray[np.bool_]
Chosen = str | frozenset[str] | None
#: A cell's text with its style, over the lines: (row, column) -> (character, style).
Labels = dict[tuple[int, int], tuple[str, Style]]


class MapView(Widget, can_focus=True):
    """Shows a model's nodes where they are. Posts :class:`Picked` for clicks."""

    DEFAULT_CSS = "MapView { background: #12161c; }"

    class Picked(Message):
        """A node (its name), a link (its two names) or a place (metres) was clicked."""

        def __init__(self, chosen: Chosen, place_m: Point) -> None:
            super().__init__()
            self.chosen = chosen
            self.place_m = place_m

    def __init__(self, model: LiveModel, *, relays: Collection[str] = (), id: str | None = None) -> None:
        super().__init__(id=id)
        self.model = model
        self._relays = relays
        self.chosen: Chosen = None
        #: Where a move would lead, while one is being made.
        self.target_m: Point | None = None
        self._projection = fit([], 1, 1)
        self._shape: tuple[object, ...] = ()
        self._rock = Layer(0, 0)
        self._floor = np.zeros((0, 0), dtype=np.bool_)
        self._drawn: tuple[object, ...] = ()
        self._layer = Layer(0, 0)
        self._labels: Labels = {}
        self._rows: dict[int, tuple[bytes, Strip]] = {}

    # -- drawing --------------------------------------------------------------------------------------------------

    def update_map(self) -> None:
        """Draw what has changed since the last time."""
        if self.size.width < 8 or self.size.height < 4:
            return
        self._fit()
        places = self.places()
        dots = {name: self._projection.dots(place) for name, place in places.items()}
        drawn = (
            tuple((name, round(x), round(y)) for name, (x, y) in dots.items()),
            tuple((link.name, link.grade) for link in self.model.shown_links()),
            tuple(node.active for node in self.model.nodes.values()),
            self.chosen,
            self.target_m,
            self._shape,
        )
        if drawn == self._drawn:
            return
        self._drawn = drawn
        self._layer = self._rock.copy()
        self._layer.draw(self._link_lines(dots))
        self._labels = dict(self._label_cells(places))
        for row in range(self.size.height):
            if self._row_key(row) != self._rows.get(row, (b"", None))[0]:
                self.refresh(Region(0, row, self.size.width, 1))

    def render_line(self, y: int) -> Strip:
        """One row; made only when its cells have changed."""
        if y >= self._layer.size[1]:
            return Strip.blank(self.size.width, Style(bgcolor=palette.GROUND))
        key = self._row_key(y)
        cached = self._rows.get(y)
        if cached is None or cached[0] != key:
            cached = self._rows[y] = (key, Strip(list(self._segments(y)), self.size.width))
        return cached[1]

    def places(self) -> dict[str, Point]:
        """Where every node is drawn, metres."""
        known = {name: node.position_m for name, node in self.model.nodes.items() if node.position_m is not None}
        return known if len(known) == len(self.model.nodes) else in_a_circle(list(self.model.nodes))

    @property
    def cell_m(self) -> Point:
        """How wide and high a cell is, metres."""
        return DOTS_X / self._projection.dots_per_m, DOTS_Y / self._projection.dots_per_m

    def _fit(self) -> None:
        tunnels = self.model.tunnels
        places = self.places()
        points = [point for tunnel in tunnels for point in tunnel.path_m] + list(places.values())
        bounds = _bounds(points)
        shape = (self.size, tunnels)
        old = self._shape
        if old[:2] == shape and _within(bounds, old[2]):  # somebody who walks on must not make the map tremble
            return
        self._shape = (*shape, bounds if not old or old[:2] != shape else _joined(bounds, old[2]))
        width, height = self.size
        wanted = self._shape[2]
        assert isinstance(wanted, tuple)
        self._projection = fit([(wanted[0], wanted[1]), (wanted[2], wanted[3])], width, height)
        self._rock = Layer(width, height)
        hollow = _hollow(tunnels, self._projection, self.size)
        _draw_walls(self._rock, hollow)
        self._floor = _cells(hollow, self.size)
        self._rows.clear()
        self.refresh()

    def _link_lines(self, dots: dict[str, Point]) -> Iterator[Line]:
        for link in self.model.shown_links():
            if link.a in dots and link.b in dots:
                ink, gap, (a, b) = _INKS[link.grade], _GAPS[link.grade], (dots[link.a], dots[link.b])
                yield a, b, ink, gap
                if self.chosen == frozenset((link.a, link.b)):  # three dots wide
                    steep = abs(b[1] - a[1]) > abs(b[0] - a[0])
                    for aside in (-1, 1):
                        dx, dy = (aside, 0) if steep else (0, aside)
                        yield (a[0] + dx, a[1] + dy), (b[0] + dx, b[1] + dy), ink, gap
        if self.target_m is not None and isinstance(self.chosen, str) and self.chosen in dots:
            yield dots[self.chosen], self._projection.dots(self.target_m), _CHOSEN_INK, 4

    def _label_cells(self, places: dict[str, Point]) -> Iterator[tuple[tuple[int, int], tuple[str, Style]]]:
        taken: set[tuple[int, int]] = set()
        cells = {name: self._projection.cell(place) for name, place in places.items()}
        taken.update(cells.values())
        for tunnel in self.model.tunnels:
            yield from self._tunnel_name(tunnel, taken)
        order = sorted(cells, key=lambda name: (name == self.chosen, self.model.nodes[name].active))
        for name in order:
            node, (column, row) = self.model.nodes[name], cells[name]
            if not node.active and name != self.chosen:  # carried: it is where its carrier is
                continue
            style = self._node_style(name)
            yield (column, row), ("▲" if name in self._relays else "●", style)
            text = f" {name} " if name == self.chosen else name
            start = _free_start(column, row, len(text), taken, self.size)
            for offset, character in enumerate(text):
                taken.add((start[0] + offset, start[1]))
                yield (start[0] + offset, start[1]), (character, style)
        yield from self._scale_bar()
        if self.target_m is not None:
            yield self._projection.cell(self.target_m), ("✚", Style(color=palette.CHOSEN, bold=True))

    def _scale_bar(self) -> Iterator[tuple[tuple[int, int], tuple[str, Style]]]:
        """A length of round metres in the corner, where places are real."""
        if all(node.position_m is None for node in self.model.nodes.values()):
            return
        across_m, _ = self.cell_m
        length_m = next((m for m in _ROUND_M if m / across_m >= 8), _ROUND_M[-1])
        bar = "├" + "─" * max(1, round(length_m / across_m) - 2) + f"┤ {length_m:g} m"
        style = Style(color=palette.DIM)
        for offset, character in enumerate(bar):
            yield (1 + offset, self.size.height - 1), (character, style)

    def _tunnel_name(
        self, tunnel: Tunnel, taken: set[tuple[int, int]]
    ) -> Iterator[tuple[tuple[int, int], tuple[str, Style]]]:
        (x0, y0), (x1, y1) = max(pairwise(tunnel.path_m), key=lambda leg: math.dist(*leg))
        column, row = self._projection.cell(((x0 + x1) / 2, (y0 + y1) / 2))
        style = Style(color=palette.ROCK, italic=True)
        row += 1 if abs(x1 - x0) >= abs(y1 - y0) else 0
        column += -len(tunnel.name) // 2 if abs(x1 - x0) >= abs(y1 - y0) else 2
        row += abs(x1 - x0) >= abs(y1 - y0)
        cells = [(column + offset, row) for offset in range(len(tunnel.name))]
        if not taken.intersection([(column - 1, row), *cells, (column + len(cells), row)]):
            taken.update(cells)
            yield from zip(cells, ((character, style) for character in tunnel.name), strict=True)

    def _node_style(self, name: str) -> Style:
        if name == self.chosen:
            return Style(color="#0b0e12", bgcolor=palette.CHOSEN, bold=True)
        if isinstance(self.chosen, frozenset) and name in self.chosen:
            return Style(color=palette.CHOSEN, bold=True, underline=True)
        return Style(color=palette.TEXT if self.model.nodes[name].active else palette.GONE, bold=True)

    def _row_key(self, row: int) -> bytes:
        if row >= self._layer.size[1]:
            return b"-"
        labels = "".join(f"{x}{text}{style}" for (x, at), (text, style) in self._labels.items() if at == row)
        cells: bytes = self._layer.masks[row].tobytes() + self._layer.inks[row].tobytes()
        return cells + labels.encode()

    def _segments(self, row: int) -> Iterator[Segment]:
        text = characters(self._layer.masks[row])
        inks, floor = self._layer.inks[row].tolist(), self._floor[row].tolist()
        run, run_style = "", None
        for column in range(self.size.width):
            ground = palette.FLOOR if floor[column] else palette.GROUND
            label = self._labels.get((column, row))
            if label is not None:
                character, style = label
                style = style if style.bgcolor is not None else _style(style, ground)
            else:
                character, style = text[column], _ink_style(inks[column], ground)
            if style is run_style:
                run += character
            else:
                if run_style is not None:
                    yield Segment(run, run_style)
                run, run_style = character, style
        if run_style is not None:
            yield Segment(run, run_style)

    # -- pointing -------------------------------------------------------------------------------------------------

    def on_click(self, event: events.Click) -> None:
        """Say what was clicked: a node before a link before a bare place."""
        cell = (event.x, event.y)
        places = self.places()
        shown = {name: place for name, place in places.items() if self.model.nodes[name].active}
        cells = {name: self._projection.cell(place) for name, place in shown.items()}
        place_m = self._projection.place(*cell)
        chosen: Chosen = nearest(cell, cells, within=3.0)
        if chosen is None:
            chosen = self._link_at((event.x * DOTS_X + 1, event.y * DOTS_Y + 2), places)
        self.post_message(self.Picked(chosen, place_m))

    def _link_at(self, dot: Point, places: dict[str, Point]) -> frozenset[str] | None:
        def distance(link: Link) -> float:
            a, b = self._projection.dots(places[link.a]), self._projection.dots(places[link.b])
            return distance_to_line(dot, a, b)

        links = [link for link in self.model.shown_links() if link.a in places and link.b in places]
        best = min(links, key=distance, default=None)
        return frozenset((best.a, best.b)) if best is not None and distance(best) <= 3 * DOTS_X else None


_styles: dict[tuple[object, str], Style] = {}


def _ink_style(ink: int, ground: str) -> Style:
    style = _styles.get((ink, ground))
    if style is None:
        style = _styles[ink, ground] = Style(color=_COLOURS[ink], bgcolor=ground)
    return style


def _style(style: Style, ground: str) -> Style:
    known = _styles.get((style, ground))
    if known is None:
        known = _styles[style, ground] = style + Style(bgcolor=ground)
    return known


def _bounds(points: list[Point]) -> tuple[float, float, float, float]:
    xs, ys = [x for x, _ in points] or [0.0], [y for _, y in points] or [0.0]
    return min(xs), min(ys), max(xs), max(ys)


def _within(inner: tuple[float, ...], outer: object) -> bool:
    assert isinstance(outer, tuple)
    return bool(inner[0] >= outer[0] and inner[1] >= outer[1] and inner[2] <= outer[2] and inner[3] <= outer[3])


def _joined(a: tuple[float, ...], b: object) -> tuple[float, float, float, float]:
    """Both, and a bit more, so that a walk outwards does not fit the map anew at each step."""
    assert isinstance(b, tuple)
    left, bottom, right, top = min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])
    more = 0.1 * max(right - left, top - bottom)
    return (
        left - more * (left < b[0]),
        bottom - more * (bottom < b[1]),
        right + more * (right > b[2]),
        top + more * (top > b[3]),
    )


def _hollow(tunnels: tuple[Tunnel, ...], projection: Projection, size: Size) -> Hollow:
    """Which dots lie in a tunnel, ``[row, column]``; the narrowest is drawn four dots wide."""
    x, y = np.meshgrid(np.arange(size.width * DOTS_X) + 0.5, np.arange(size.height * DOTS_Y) + 0.5)
    found = np.zeros(x.shape, dtype=np.bool_)
    for tunnel in tunnels:
        half = max(tunnel.width_m / 2 * projection.dots_per_m, 3.0)
        for p, q in pairwise(tunnel.path_m):
            (x0, y0), (x1, y1) = projection.dots(p), projection.dots(q)
            length = (x1 - x0) ** 2 + (y1 - y0) ** 2 or 1.0
            share = np.clip(((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length, 0.0, 1.0)
            found |= np.hypot(x - x0 - share * (x1 - x0), y - y0 - share * (y1 - y0)) <= half
    return found


def _draw_walls(layer: Layer, hollow: Hollow) -> None:
    """Set the dots of the rock that border on a hollow one."""
    around = np.pad(hollow, 1)
    touches = around[:-2, 1:-1] | around[2:, 1:-1] | around[1:-1, :-2] | around[1:-1, 2:]
    rows, columns = np.nonzero(touches & ~hollow)
    layer.set(columns.astype(np.float64), rows.astype(np.float64), np.full(len(rows), _ROCK_INK, dtype=np.uint8))


def _cells(hollow: Hollow, size: Size) -> Hollow:
    """Which cells are mostly hollow."""
    counted = hollow.reshape(size.height, DOTS_Y, size.width, DOTS_X).sum(axis=(1, 3))
    half: Hollow = counted >= DOTS_X * DOTS_Y // 2
    return half


def _free_start(column: int, row: int, length: int, taken: set[tuple[int, int]], size: Size) -> tuple[int, int]:
    """Where a name goes: right of its node, else left, below, above, or right over what is there."""
    right, left, middle = column + 2, column - 1 - length, column - length // 2
    for start, at in ((right, row), (left, row), (middle, row + 1), (middle, row - 1), (right, row + 1)):
        cells = {(start + offset, at) for offset in range(length)}
        if not cells & taken and start >= 0 and start + length <= size.width and 0 <= at < size.height:
            return start, at
    return right, row
