"""What is written over the map: nodes with their names, names of tunnels, the scale, the target of a move. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from itertools import pairwise

from rich.style import Style

from netlab.live.model import Tunnel
from netlab.tui import palette
from netlab.tui.braille import DOTS_X
from netlab.tui.projection import Cell
from netlab.tui.scene import Scene

#: Row -> column -> (character, style); a style without a background lets the ground show.
Labels = dict[int, dict[int, tuple[str, Style]]]

_ROUND_M = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_LEAST_BAR_CELLS = 8
_ON_CHOSEN = "#0b0e12"
_TUNNEL_NAME = Style(color=palette.ROCK, italic=True)
_SCALE = Style(color=palette.DIM)
_TARGET = Style(color=palette.CHOSEN, bold=True)


def labels_of(scene: Scene, columns: int, rows: int, *, relays: Collection[str] = ()) -> Labels:
    """All that is written over a scene in so many cells. ``relays``: the nodes that have a sign of their own."""
    labels: Labels = {}
    for (column, row), text, style in _writings(scene, columns, rows, relays):
        written = labels.setdefault(row, {})
        for offset, character in enumerate(text):
            written[column + offset] = (character, style)
    return labels


def _writings(scene: Scene, columns: int, rows: int, relays: Collection[str]) -> Iterator[tuple[Cell, str, Style]]:
    """Texts by the cell where they begin; a later one is written over an earlier one."""
    cells = scene.cells(scene.dots.keys())
    taken = set(cells.values())
    if scene.is_to_scale:
        bar = _scale_bar(DOTS_X / scene.projection.dots_per_m)
        taken.update((1 + offset, rows - 1) for offset in range(len(bar)))
        yield (1, rows - 1), bar, _SCALE
    for tunnel in scene.tunnels:
        yield from _tunnel_name(scene, tunnel, taken)
    for name in sorted(cells, key=lambda name: (name == scene.chosen, name in scene.active)):
        if name not in scene.active and name != scene.chosen:  # carried: it is where its carrier is
            continue
        style = _node_style(scene, name)
        yield cells[name], "▲" if name in relays else "●", style
        text = f" {name} " if name == scene.chosen else name
        column, row = _free_start(cells[name], len(text), taken, columns, rows)
        taken.update((column + offset, row) for offset in range(len(text)))
        yield (column, row), text, style
    if scene.target_m is not None:
        yield scene.projection.cell(scene.target_m), "✚", _TARGET


def _scale_bar(cell_m: float) -> str:
    """A length of round metres. ``cell_m``: how wide a cell is."""
    length_m = next((m for m in _ROUND_M if m / cell_m >= _LEAST_BAR_CELLS), _ROUND_M[-1])
    return "├" + "─" * max(1, round(length_m / cell_m) - 2) + f"┤ {length_m:g} m"


def _tunnel_name(scene: Scene, tunnel: Tunnel, taken: set[Cell]) -> Iterator[tuple[Cell, str, Style]]:
    """Beside the middle of the longest leg, unless something stands there."""
    (x0, y0), (x1, y1) = max(pairwise(tunnel.path_m), key=lambda leg: math.dist(*leg))
    column, row = scene.projection.cell(((x0 + x1) / 2, (y0 + y1) / 2))
    is_level = abs(x1 - x0) >= abs(y1 - y0)
    column += -len(tunnel.name) // 2 if is_level else 2
    row += 2 if is_level else 0
    cells = [(column + offset, row) for offset in range(len(tunnel.name))]
    if not taken.intersection([(column - 1, row), *cells, (column + len(cells), row)]):
        taken.update(cells)
        yield (column, row), tunnel.name, _TUNNEL_NAME


def _node_style(scene: Scene, name: str) -> Style:
    if name == scene.chosen:
        return Style(color=_ON_CHOSEN, bgcolor=palette.CHOSEN, bold=True)
    if isinstance(scene.chosen, frozenset) and name in scene.chosen:
        return Style(color=palette.CHOSEN, bold=True, underline=True)
    return Style(color=palette.TEXT if name in scene.active else palette.GONE, bold=True)


def _free_start(node: Cell, length: int, taken: set[Cell], columns: int, rows: int) -> Cell:
    """Where a name goes: right of its node, else left, below, above, or right over what is there."""
    column, row = node
    right, left, middle = column + 2, column - 1 - length, column - length // 2
    for start, at in ((right, row), (left, row), (middle, row + 1), (middle, row - 1), (right, row + 1)):
        cells = {(start + offset, at) for offset in range(length)}
        if not cells & taken and start >= 0 and start + length <= columns and 0 <= at < rows:
            return start, at
    return right, row
