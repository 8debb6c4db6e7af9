"""A run, with all that a person did in it, as a scenario file that does it again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from netlab.errors import LabError
from netlab.scenario import load_scenario
from netlab.scenario.quantities import DURATION
from netlab.scenario.saved import own_events, with_events
from netlab.timeline.replay import Row, replay


@dataclass(frozen=True, slots=True)
class Original:
    """What a lab was started with: a file's text and what was laid over it."""

    text: str
    overrides: tuple[str, ...] = ()
    others: Mapping[str, Any] | None = None  # further top-level values, such as the seed


def read_journal(path: Path) -> list[Row]:
    """The rows of a lab's timeline; a last line that is being written is left out."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            rows.append(Row(json.loads(line)))
        except ValueError:
            continue
    return rows


def save(path: Path, original: Original, rows: Sequence[Row], *, duration_s: float, end_s: float) -> tuple[str, ...]:
    """Write the scenario file; returns what no file can say.

    Args:
        path: Where to; its folder is made.
        original: What was run.
        rows: The timeline so far.
        duration_s: Of the original.
        end_s: Run time now.

    Raises:
        LabError: It cannot be written, or would not load (a file that it names is looked for beside it).
    """
    made = replay(own_events(original.text, original.overrides), rows, duration_s=duration_s, end_s=end_s)
    text = with_events(
        original.text,
        made.events,
        duration=DURATION.format(round(made.duration_s, 3)) if made.duration_s != duration_s else None,
        overrides=original.overrides,
        others=original.others,
        remark=_remark(made.left_out),
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    except OSError as error:
        raise LabError(f"{path}: cannot be written: {error.strerror}") from None
    load_scenario(path)
    return made.left_out


def _remark(left_out: Iterable[str]) -> str:
    lines = ["Saved from a run: the scenario with what was done to it by hand."]
    return "\n".join([*lines, *(f"Left out, as no event says it: {text}" for text in left_out)])
