"""Rows of an answer, and their three forms: text for people, JSON for programs, CSV for spreadsheets."""

from __future__ import annotations

import csv
import io
import json
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from netlab.traces.tables import columns

Row = Mapping[str, object]


class Format(StrEnum):
    """How to print."""

    TEXT = "text"
    JSON = "json"
    CSV = "csv"


@dataclass(frozen=True, slots=True)
class Column:
    """One column. ``key``: of the row, with its unit; ``head``: over the text; ``text``: how a person reads a value."""

    key: str
    head: str = ""
    text: Callable[[object], str] = field(default=lambda value: "" if value is None else str(value))
    is_left: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """An answer. Columns without a head are not in the text. ``empty``: what to say when there are no rows."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    empty: str = "nothing"

    def text(self, *, width: int) -> str:
        """The title and one line per row; the last column is wrapped where the line is too long."""
        shown = [column for column in self.columns if column.head]
        if not self.rows:
            return f"{self.title}\n  {self.empty}"
        cells = [[column.head for column in shown]]
        cells += [[column.text(row.get(column.key)) for column in shown] for row in self.rows]
        left = next((index for index, column in enumerate(shown) if not column.is_left), len(shown))
        return "\n".join([self.title, *(f"  {line}" for line in _laid_out(cells, left=left, width=width - 2))])

    def csv(self) -> str:
        """The rows under a line of keys (RFC 4180)."""
        return "".join(csv_lines([column.key for column in self.columns], self.rows))


def csv_lines(keys: Sequence[str], rows: Iterable[Row]) -> Iterator[str]:
    """The head, then one line per row; what is no number or text is written as JSON."""
    yield _csv_line(keys)
    for row in rows:
        yield _csv_line([_cell(row.get(key)) for key in keys])


def _csv_line(cells: Iterable[object]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(cells)
    return buffer.getvalue()


def _cell(value: object) -> object:
    if value is None:
        return ""
    return value if isinstance(value, str | int | float) else json.dumps(value)


def _laid_out(cells: list[list[str]], *, left: int, width: int) -> list[str]:
    """Columns as in :func:`netlab.traces.tables.columns`; text that leans left at the end wraps within ``width``."""
    if left < len(cells[0]):
        return columns(cells, left=left)
    fixed = columns([row[:-1] for row in cells], left=left) if len(cells[0]) > 1 else [""] * len(cells)
    indent = max(map(len, fixed)) + 2
    lines: list[str] = []
    for start, row in zip(fixed, cells, strict=True):
        wrapped = textwrap.wrap(row[-1], max(24, width - indent)) or [""]
        lines.append(f"{start.ljust(indent)}{wrapped[0]}".rstrip())
        lines += [" " * indent + more for more in wrapped[1:]]
    return lines
