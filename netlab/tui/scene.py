"""What the map shows at one moment, in dots from its top left, and what is where on it. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

from netlab.live.links import Grade
from netlab.live.model import LiveModel, Tunnel
from netlab.tui.braille import DOTS_X, DOTS_Y, Line
from netlab.tui.projection import Point, Projection, distance_to_line, in_a_circle, nearest

#: A node (its name), a link (its two names), or nothing.
Chosen = str | frozenset[str] | None

INKS = {Grade.OUT_OF_RANGE: 2, Grade.DOWN: 3, Grade.POOR: 4, Grade.FAIR: 5, Grade.GOOD: 6}
CHOSEN_INK = 7
_GAPS = {Grade.GOOD: 1, Grade.FAIR: 2, Grade.POOR: 3, Grade.DOWN: 5, Grade.OUT_OF_RANGE: 8}
_TARGET_GAP = 4
_REACH_CELLS = 3  # how far off a click may be


def places(model: LiveModel) -> dict[str, Point]:
    """Where every node is drawn, metres: where it is, or on a circle if that is not known of all."""
    known = {name: node.position_m for name, node in model.nodes.items() if node.position_m is not None}
    return known if len(known) == len(model.nodes) else in_a_circle(list(model.nodes))


@dataclass(frozen=True, slots=True)
class Scene:
    """Nodes, links and what is chosen. Scenes are equal when they look the same, to half a dot.

    Attributes:
        projection: From metres to dots.
        tunnels: Those with names on the map.
        rounded: Where each node is, in whole dots.
        active: The nodes that nobody carries.
        links: (node, node, grade) of the links that are worth a line.
        chosen: What the person has picked.
        target_m: Where a node is about to be moved.
        is_to_scale: Whether distances on the map mean anything.
        dots: Where each node is, exactly.
    """

    projection: Projection
    tunnels: tuple[Tunnel, ...]
    rounded: tuple[tuple[str, int, int], ...]
    active: frozenset[str]
    links: tuple[tuple[str, str, Grade], ...]
    chosen: Chosen
    target_m: Point | None
    is_to_scale: bool
    dots: dict[str, Point] = field(compare=False)

    @classmethod
    def of(cls, model: LiveModel, projection: Projection, *, chosen: Chosen, target_m: Point | None) -> Scene:
        """As a model is now."""
        dots = {name: projection.dots(place) for name, place in places(model).items()}
        shown = ((link.a, link.b, link.grade) for link in model.shown_links())
        return cls(
            projection=projection,
            tunnels=model.tunnels,
            rounded=tuple((name, round(x), round(y)) for name, (x, y) in dots.items()),
            active=frozenset(name for name, node in model.nodes.items() if node.active),
            links=tuple((a, b, grade) for a, b, grade in shown if a in dots and b in dots),
            chosen=chosen,
            target_m=target_m,
            is_to_scale=any(node.position_m is not None for node in model.nodes.values()),
            dots=dots,
        )

    def lines(self) -> Iterator[Line]:
        """The links; the chosen one three dots wide; from a node to its target."""
        for name_a, name_b, grade in self.links:
            ink, gap, a, b = INKS[grade], _GAPS[grade], self.dots[name_a], self.dots[name_b]
            yield a, b, ink, gap
            if self.chosen == frozenset((name_a, name_b)):
                steep = abs(b[1] - a[1]) > abs(b[0] - a[0])
                for aside in (-1, 1):
                    dx, dy = (aside, 0) if steep else (0, aside)
                    yield (a[0] + dx, a[1] + dy), (b[0] + dx, b[1] + dy), ink, gap
        if self.target_m is not None and isinstance(self.chosen, str) and self.chosen in self.dots:
            yield self.dots[self.chosen], self.projection.dots(self.target_m), CHOSEN_INK, _TARGET_GAP

    def cells(self, names: Collection[str]) -> dict[str, tuple[int, int]]:
        """The cells of some nodes: (column, row)."""
        return {name: (int(x // DOTS_X), int(y // DOTS_Y)) for name, (x, y) in self.dots.items() if name in names}

    def at(self, column: int, row: int) -> Chosen:
        """What is at a cell, or near enough to it: a node before a link."""
        node = nearest((column, row), self.cells(self.active), within=_REACH_CELLS)
        if node is not None:
            return node
        middle = (column + 0.5) * DOTS_X, (row + 0.5) * DOTS_Y

        def distance(link: tuple[str, str, Grade]) -> float:
            return distance_to_line(middle, self.dots[link[0]], self.dots[link[1]])

        best = min(self.links, key=distance, default=None)
        return frozenset(best[:2]) if best is not None and distance(best) <= _REACH_CELLS * DOTS_X else None
