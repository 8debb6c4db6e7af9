"""Lines as braille characters: eight dots in each cell of the terminal, two across and four down. Pure; NumPy.

A layer holds for every cell which dots are set and one ink (a small number that a palette makes a colour of). Where
lines cross in a cell the higher ink wins.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

DOTS_X, DOTS_Y = 2, 4
_BLANK = 0x2800
#: Bit of the dot at [row, column] of a cell; Unicode Standard, chapter 21.1 (braille patterns).
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)

Dots = tuple[float, float]
#: A line from dot to dot with its ink; every ``gap``-th dot is set (1: all).
Line = tuple[Dots, Dots, int, int]


class Layer:
    """Dots and inks of ``rows`` x ``columns`` cells."""

    def __init__(self, columns: int, rows: int) -> None:
        self.masks: NDArray[np.uint8] = np.zeros((rows, columns), dtype=np.uint8)
        self.inks: NDArray[np.uint8] = np.zeros((rows, columns), dtype=np.uint8)

    @property
    def size(self) -> tuple[int, int]:
        """(columns, rows)."""
        rows, columns = self.masks.shape
        return columns, rows

    def copy(self) -> Layer:
        """Another one that looks the same."""
        twin = Layer(0, 0)
        twin.masks, twin.inks = self.masks.copy(), self.inks.copy()
        return twin

    def draw(self, lines: Iterable[Line]) -> None:
        """Set the dots of lines, all at once; what lies outside is left out."""
        rows = [(x0, y0, x1 - x0, y1 - y0, ink, gap) for (x0, y0), (x1, y1), ink, gap in lines]
        if not rows:
            return
        x0, y0, dx, dy, ink, gap = np.array(rows, dtype=np.float64).T
        steps = np.maximum(1.0, np.ceil(np.maximum(np.abs(dx), np.abs(dy))))
        counts = (steps // gap).astype(np.int64) + 1
        line = np.repeat(np.arange(len(rows)), counts)
        number = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts)
        share = number * gap[line] / steps[line]
        self.set(x0[line] + dx[line] * share, y0[line] + dy[line] * share, ink[line].astype(np.uint8))

    def set(self, x: NDArray[np.float64], y: NDArray[np.float64], inks: NDArray[np.uint8]) -> None:
        """Set dots by their coordinates (dots, from the top left)."""
        column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        rows, columns = self.masks.shape
        inside = (column >= 0) & (row >= 0) & (column < columns * DOTS_X) & (row < rows * DOTS_Y)
        column, row, inks = column[inside], row[inside], inks[inside]
        cell = (row // DOTS_Y, column // DOTS_X)
        np.bitwise_or.at(self.masks, cell, _BITS[row % DOTS_Y, column % DOTS_X])
        np.maximum.at(self.inks, cell, inks)


def characters(masks: NDArray[np.uint8]) -> str:
    """One row of cells as text; a cell without dots is a space."""
    return "".join(" " if mask == 0 else chr(_BLANK + mask) for mask in masks.tolist())
