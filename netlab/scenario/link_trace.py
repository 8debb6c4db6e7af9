"""A measured trace of links: who hears whom with which loss, delay and rate, row by row over time, from a CSV file."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import Annotated

from pydantic import BeforeValidator, ValidationInfo, WithJsonSchema

from netlab.scenario.base import Problems
from netlab.scenario.quantities import describe
from netlab.scenario.words import read_file

TRACE_COLUMNS = ("at_s", "from", "to", "loss_percent", "delay_ms", "rate_mbit")
_MOST_TRACE_PROBLEMS = 20


@dataclass(frozen=True, slots=True)
class TraceRow:
    """From ``at_s`` on, this is how ``sender`` reaches ``receiver``; None leaves the word as it was before.

    ``loss_ratio`` 1 means out of range. ``line`` is the row's line in the file, for messages.
    """

    at_s: float
    sender: str
    receiver: str
    loss_ratio: float | None
    delay_s: float | None
    rate_bps: float | None
    line: int


@dataclass(frozen=True, slots=True)
class LinkTrace:
    """A measured trace: the file's name as the scenario gives it, and its rows by time."""

    name: str
    rows: tuple[TraceRow, ...]


def parse_link_trace(name: str, text: str) -> LinkTrace:
    """Read a CSV trace with the columns ``TRACE_COLUMNS``; lines that begin with # are comments, empty cells keep.

    Raises:
        Problems: One text per wrong line, with the file's name and the line.
    """
    problems: list[str] = []
    rows: list[TraceRow] = []
    header: list[str] | None = None
    for number, cells in enumerate(csv.reader(io.StringIO(text)), start=1):
        if not cells or cells[0].lstrip().startswith("#"):
            continue
        stripped = [cell.strip() for cell in cells]
        if header is None:
            header = stripped
            if header != list(TRACE_COLUMNS):
                raise Problems([f"{name}:{number}: the columns must be {','.join(TRACE_COLUMNS)}"])
            continue
        try:
            rows.append(_trace_row(stripped, number))
        except ValueError as error:
            problems.append(f"{name}:{number}: {error}")
    if header is None:
        problems.append(f"{name}: the file is empty; it needs the columns {','.join(TRACE_COLUMNS)}")
    if problems:
        raise Problems(problems[:_MOST_TRACE_PROBLEMS])
    return LinkTrace(name, tuple(sorted(rows, key=lambda row: row.at_s)))


def _trace_row(cells: list[str], line: int) -> TraceRow:
    if len(cells) != len(TRACE_COLUMNS):
        raise ValueError(f"{len(cells)} cells; there must be {len(TRACE_COLUMNS)}")
    at_s, sender, receiver, loss_percent, delay_ms, rate_mbit = cells
    loss = _cell("loss_percent", loss_percent, 100.0)
    delay = _cell("delay_ms", delay_ms)
    rate = _cell("rate_mbit", rate_mbit)
    at = _cell("at_s", at_s)
    if at is None:
        raise ValueError("at_s is empty; give the time in seconds")
    if rate == 0:
        raise ValueError("rate_mbit 0 is impossible; leave the cell empty, or give loss_percent 100 for out of range")
    return TraceRow(
        at_s=at,
        sender=sender,
        receiver=receiver,
        loss_ratio=None if loss is None else loss / 100,
        delay_s=None if delay is None else delay / 1e3,
        rate_bps=None if rate is None else rate * 1e6,
        line=line,
    )


def _cell(column: str, text: str, most: float = float("inf")) -> float | None:
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{column} '{text}' is not a number; the column's name gives the unit") from None
    if not 0 <= value <= most or value == float("inf"):
        raise ValueError(f"{column} {text} is impossible; it must be {'0 or more' if most > 100 else '0 to 100'}")
    return value


def _link_trace(value: object, info: ValidationInfo) -> LinkTrace:
    if not isinstance(value, str):
        raise ValueError(f"expected the name of a CSV file, found {describe(value)}")
    return parse_link_trace(value, read_file(info, value))


LinkTraceFile = Annotated[LinkTrace, BeforeValidator(_link_trace), WithJsonSchema({"type": "string"})]
