"""`--set a.b.c=value`: replace one value of a scenario before it is validated. List items: `links.0` or `links[0]`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from netlab.scenario.document import Document, Path, dotted
from netlab.scenario.quantities import describe
from netlab.scenario.yaml_source import read_value

_PART = re.compile(r"[^.\[\]]+")


def apply_overrides(document: Document, overrides: Sequence[str]) -> list[str]:
    """Set every ``path=value`` in ``document`` (which is changed); return the problems."""
    problems: list[str] = []
    for override in overrides:
        origin = f"--set {override}"
        try:
            path, value = _parse(override)
            set_value(document, path, value, origin=origin)
        except ValueError as error:
            problems.append(f"{origin}: {error}")
    return problems


def set_value(document: Document, path: Path, value: Any, *, origin: str) -> None:
    """Put ``value`` at ``path``; blocks on the way are made where they are missing.

    Raises:
        ValueError: The path leads through something that is neither a block nor a list, or past a list's end.
    """
    here: Any = document.data
    for depth, part in enumerate(path):
        here, key = _step(here, part, path[:depth])
        if depth == len(path) - 1:
            here[key] = value
        elif isinstance(here, list):
            here = here[key]
        else:
            if here.get(key) is None:
                here[key] = {}
            here = here[key]
    keys = _real_path(document.data, path)
    for known in [known for known in document.marks if known[: len(keys)] == keys]:
        del document.marks[known]
    document.marks[keys] = origin


def _parse(override: str) -> tuple[Path, Any]:
    left, equals, right = override.partition("=")
    path = tuple(_PART.findall(left.strip()))
    if not equals or not path:
        raise ValueError("is not of the form key.path=value; write for example --set duration=10s")
    value = read_value(right)
    if value is None:
        raise ValueError("the value is missing; write it behind the =")
    return path, value


def _step(here: Any, part: str | int, so_far: Path) -> tuple[Any, Any]:
    if isinstance(here, dict):
        return here, str(part)
    if not isinstance(here, list):
        raise ValueError(f"{dotted(so_far)} is {describe(here)}, which has no '{part}' in it")
    if not str(part).isdigit():
        raise ValueError(f"{dotted(so_far)} is a list; name an entry by its number, 0 to {len(here) - 1}")
    index = int(part)
    if index >= len(here):
        raise ValueError(f"{dotted(so_far)} has {len(here)} entries, numbered from 0; there is no {index}")
    return here, index


def _real_path(data: Any, path: Path) -> Path:
    """``path`` with list indices as numbers, as marks have them."""
    real: list[str | int] = []
    for part in path:
        key: str | int = int(part) if isinstance(data, list) else str(part)
        real.append(key)
        data = data[key]
    return tuple(real)
