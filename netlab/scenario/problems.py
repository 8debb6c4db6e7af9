"""Pydantic's complaints about a document as (path, message) pairs that follow the file rather than the models."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from netlab.scenario.base import Problems
from netlab.scenario.document import Path

Problem = tuple[Path, str]


def validation_problems(error: ValidationError, data: Any) -> list[Problem]:
    """Return every complaint of ``error`` about ``data``, with the path of the part that it is about."""
    found: list[Problem] = []
    for line in error.errors(include_url=False, include_input=False):
        path = _file_path(line["loc"], data)
        found += [(path, message) for message in _messages(dict(line))]
    return found


def _messages(line: dict[str, Any]) -> tuple[str, ...]:
    if line["type"] == "value_error":
        cause = line["ctx"]["error"]
        return cause.problems if isinstance(cause, Problems) else (str(cause),)
    return (line["msg"],)


def _file_path(loc: tuple[str | int, ...], data: Any) -> Path:
    """Drop the parts of a location that name a model or the inside of a shorthand, not a key of the file.

    A missing or empty key is the last part and kept although the data does not have it.
    """
    path: list[str | int] = []
    for position, part in enumerate(loc):
        if isinstance(part, str) and part.startswith(("<", "[key]")):
            continue
        if isinstance(data, dict):
            if part not in data and position < len(loc) - 1:
                break
            path.append(part)
            data = data.get(part)
        elif isinstance(data, (list, tuple)) and isinstance(part, int) and part < len(data):
            path.append(part)
            data = data[part]
        else:
            break
    return tuple(path)
