"""Tunnels as the map shows them: the rock around them in dots, and the cells that are floor. Pure; NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from netlab.live.model import Tunnel
from netlab.tui.braille import DOTS_X, DOTS_Y, Layer
from netlab.tui.projection import Projection

ROCK_INK = 1
_LEAST_HALF_WIDTH_DOTS = 3.0
Mask = NDArray[np.bool_]


def draw_rock(tunnels: Sequence[Tunnel], projection: Projection, columns: int, rows: int) -> tuple[Layer, Mask]:
    """The walls as dots on an otherwise empty layer, and which cells (``[row, column]``) are mostly floor."""
    hollow = _hollow(tunnels, projection, columns, rows)
    walls = Layer(columns, rows)
    _draw_walls(walls, hollow)
    hollow_dots = hollow.reshape(rows, DOTS_Y, columns, DOTS_X).sum(axis=(1, 3))
    floor: Mask = hollow_dots >= DOTS_X * DOTS_Y // 2
    return walls, floor


def _hollow(tunnels: Sequence[Tunnel], projection: Projection, columns: int, rows: int) -> Mask:
    """Which dots lie in a tunnel, ``[row, column]``; the narrowest is drawn six dots wide."""
    x, y = np.meshgrid(np.arange(columns * DOTS_X) + 0.5, np.arange(rows * DOTS_Y) + 0.5)
    found = np.zeros(x.shape, dtype=np.bool_)
    for tunnel in tunnels:
        half = max(tunnel.width_m / 2 * projection.dots_per_m, _LEAST_HALF_WIDTH_DOTS)
        for p, q in pairwise(tunnel.path_m):
            (x0, y0), (x1, y1) = projection.dots(p), projection.dots(q)
            length = (x1 - x0) ** 2 + (y1 - y0) ** 2 or 1.0
            share = np.clip(((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length, 0.0, 1.0)
            found |= np.hypot(x - x0 - share * (x1 - x0), y - y0 - share * (y1 - y0)) <= half
    return found


def _draw_walls(layer: Layer, hollow: Mask) -> None:
    """Set the dots of the rock that border on a hollow one."""
    around = np.pad(hollow, 1)
    touches = around[:-2, 1:-1] | around[2:, 1:-1] | around[1:-1, :-2] | around[1:-1, 2:]
    rows, columns = np.nonzero(touches & ~hollow)
    layer.set(columns.astype(np.float64), rows.astype(np.float64), np.full(len(rows), ROCK_INK, dtype=np.uint8))
