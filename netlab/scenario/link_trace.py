"""A measured trace of links: how who hears whom with which loss, delay, rate or strength over time, from a CSV file."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Annotated

from pydantic import BeforeValidator, ValidationInfo, WithJsonSchema

from netlab.scenario.base import Problems, suggestion
from netlab.scenario.quantities import describe
from netlab.scenario.words import read_file

_ENDS = (("from", "to"), ("a", "b"))  # one direction per row, or both
_MOST_TRACE_PROBLEMS = 20


@dataclass(frozen=True, slots=True)
class TraceRow:
    """From ``at_s`` on, this is how ``sender`` reaches ``receiver``; None leaves the word as it was before.

    ``loss_ratio`` 1, ``path_loss_db`` inf and ``rssi_dbm`` -inf mean out of range. ``line`` is that of the row in the
    file, for messages.
    """

    at_s: float
    sender: str
    receiver: str
    loss_ratio: float | None = None
    delay_s: float | None = None
    rate_bps: float | None = None
    path_loss_db: float | None = None
    rssi_dbm: float | None = None
    line: int = 0

    @property
    def has_words(self) -> bool:
        """Whether it says anything of loss, delay or rate."""
        return (self.loss_ratio, self.delay_s, self.rate_bps) != (None, None, None)

    @property
    def has_strength(self) -> bool:
        """Whether it says how strongly the sender is heard."""
        return self.path_loss_db is not None or self.rssi_dbm is not None


@dataclass(frozen=True, slots=True)
class LinkTrace:
    """A measured trace: the file's name as the scenario gives it, and its rows by time."""

    name: str
    rows: tuple[TraceRow, ...]

    @property
    def has_strengths(self) -> bool:
        """Whether it says how strongly signals arrive."""
        return any(row.has_strength for row in self.rows)


def parse_link_trace(name: str, text: str) -> LinkTrace:
    """Read a CSV trace. Lines that begin with # are comments, empty cells keep what was.

    The first line names the columns, in any order: ``at_s``; ``from`` and ``to``, or ``a`` and ``b`` for both
    directions at once; and some of ``VALUES``, at most one of them a strength.

    Raises:
        Problems: One text per wrong line, with the file's name and the line.
    """
    problems: list[str] = []
    rows: list[TraceRow] = []
    columns: list[str] | None = None
    for number, cells in enumerate(csv.reader(io.StringIO(text)), start=1):
        if not cells or cells[0].lstrip().startswith("#"):
            continue
        stripped = [cell.strip() for cell in cells]
        if columns is None:
            if complaint := _wrong_columns(stripped):
                raise Problems([f"{name}:{number}: {complaint}"])
            columns = stripped
            continue
        try:
            if len(stripped) != len(columns):
                raise ValueError(f"{len(stripped)} cells; there must be {len(columns)}")
            rows += _rows(dict(zip(columns, stripped, strict=True)), number)
        except ValueError as error:
            problems.append(f"{name}:{number}: {error}")
    if columns is None:
        problems.append(f"{name}: the file is empty; it needs columns such as at_s,from,to,loss_percent")
    if problems:
        raise Problems(problems[:_MOST_TRACE_PROBLEMS])
    return LinkTrace(name, tuple(sorted(rows, key=lambda row: row.at_s)))


def _wrong_columns(columns: list[str]) -> str | None:
    known = ("at_s", *(end for ends in _ENDS for end in ends), *VALUES)
    for column in columns:
        if column not in known:
            return f"unknown column '{column}'; {suggestion(column, known, 'known are')}"
        if columns.count(column) > 1:
            return f"there are two columns {column}; remove one"
    ends = [pair for pair in _ENDS if set(pair) & set(columns)]
    if "at_s" not in columns or len(ends) != 1 or not set(ends[0]) <= set(columns):
        return "the columns must be at_s, then from and to (one direction) or a and b (both), then values"
    if {"path_loss_db", "rssi_dbm"} <= set(columns):
        return "path_loss_db and rssi_dbm say the same; remove one of the columns"
    if not set(VALUES) & set(columns):
        return f"there is no value; add some of {', '.join(VALUES)}"
    return None


def _rows(row: dict[str, str], line: int) -> Iterator[TraceRow]:
    at_s = _number("at_s", row["at_s"])
    if at_s is None:
        raise ValueError("at_s is empty; give the time in seconds")
    values = {attribute: read(row[column]) for column, (attribute, read) in VALUES.items() if column in row}
    hops = [(row["from"], row["to"])] if "from" in row else [(row["a"], row["b"]), (row["b"], row["a"])]
    for sender, receiver in hops:
        yield TraceRow(at_s, sender, receiver, **values, line=line)


def _number(
    column: str, text: str, *, least: float = 0.0, most: float = math.inf, never: float | None = None
) -> float | None:
    """A cell as a number; None if it is empty. ``never`` is the infinity that means out of range."""
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{column} '{text}' is not a number; the column's name gives the unit") from None
    if value != never and not (least <= value <= most and math.isfinite(value)):
        bounds = f"{least:g} or more" if most == math.inf else f"{least:g} to {most:g}"
        also = "" if never is None else f", or {never:g} for out of range"
        raise ValueError(f"{column} {text} is impossible; it must be {bounds}{also}")
    return value


def _scaled(column: str, factor: float, text: str, *, most: float = math.inf) -> float | None:
    value = _number(column, text, most=most)
    return None if value is None else value * factor


def _rate(text: str) -> float | None:
    if (rate_bps := _scaled("rate_mbit", 1e6, text)) == 0:
        raise ValueError("rate_mbit 0 is impossible; leave the cell empty, or give loss_percent 100 for out of range")
    return rate_bps


#: Columns of values, the attributes of a row that they become, and how their cells are read.
VALUES: dict[str, tuple[str, Callable[[str], float | None]]] = {
    "loss_percent": ("loss_ratio", partial(_scaled, "loss_percent", 0.01, most=100.0)),
    "delay_ms": ("delay_s", partial(_scaled, "delay_ms", 1e-3)),
    "rate_mbit": ("rate_bps", _rate),
    "path_loss_db": ("path_loss_db", partial(_number, "path_loss_db", most=300.0, never=math.inf)),
    "rssi_dbm": ("rssi_dbm", partial(_number, "rssi_dbm", least=-200.0, most=60.0, never=-math.inf)),
}


def _link_trace(value: object, info: ValidationInfo) -> LinkTrace:
    if not isinstance(value, str):
        raise ValueError(f"expected the name of a CSV file, found {describe(value)}")
    return parse_link_trace(value, read_file(info, value))


LinkTraceFile = Annotated[LinkTrace, BeforeValidator(_link_trace), WithJsonSchema({"type": "string"})]
