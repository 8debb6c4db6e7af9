"""One row of the map as styled text: dots in their inks, ground, and what is written over them. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import groupby

from rich.segment import Segment
from rich.style import Style

from netlab.tui import palette
from netlab.tui.rock import ROCK_INK
from netlab.tui.scene import CHOSEN_INK, INKS

_COLOURS = {0: palette.TEXT, ROCK_INK: palette.ROCK, CHOSEN_INK: palette.CHOSEN} | {
    ink: palette.GRADES[grade] for grade, ink in INKS.items()
}


def row_segments(
    characters: str, inks: Sequence[int], floor: Sequence[bool], labels: Mapping[int, tuple[str, Style]]
) -> Iterator[Segment]:
    """A row, all by columns: dots as characters, their inks, which cells are floor, what is written."""

    def cell(column: int) -> tuple[str, Style]:
        ground = palette.FLOOR if floor[column] else palette.GROUND
        if column not in labels:
            return characters[column], _ink_style(inks[column], ground)
        character, style = labels[column]
        return character, style if style.bgcolor is not None else _on(style, ground)

    for style, run in groupby(map(cell, range(len(characters))), key=lambda cell: cell[1]):
        yield Segment("".join(character for character, _ in run), style)


@cache
def _ink_style(ink: int, ground: str) -> Style:
    return Style(color=_COLOURS[ink], bgcolor=ground)


@cache
def _on(style: Style, ground: str) -> Style:
    return style + Style(bgcolor=ground)
