"""A scenario before validation: plain data, and where each part of it was written.

Paths are tuples of keys and list indices. Knows nothing of what the keys mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

Path = tuple[str | int, ...]


@dataclass(slots=True)
class Document:
    """Data of one scenario with the origin of its parts.

    ``marks`` gives the origin (``file:line`` or ``--set key=value``) of a path; ``templates`` sends the paths of
    generated parts to the block that they were generated from.
    """

    name: str
    data: dict[str, Any]
    marks: dict[Path, str] = field(default_factory=dict)
    templates: dict[Path, Path] = field(default_factory=dict)

    def where(self, path: Path) -> str:
        """Return ``origin: key.path`` for a message about ``path``."""
        shown = self._written(path)
        for length in range(len(shown), -1, -1):
            origin = self.marks.get(shown[:length])
            if origin is not None:
                break
        else:
            origin = self.name
        return f"{origin}: {dotted(shown)}" if shown else origin

    def _written(self, path: Path) -> Path:
        for length in range(len(path), 0, -1):
            if path[:length] in self.marks and length > 2:
                return path
            template = self.templates.get(path[:length])
            if template is not None:
                return template + path[length:]
        return path


def dotted(path: Path) -> str:
    """Return a path as people write it: ``links[3].to``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def line_of(problem: str) -> int:
    """The line number in ``file:line: ...``; -1 when the problem has none, so that it sorts first."""
    head = problem.split(": ", 1)[0]
    number = head.rpartition(":")[2]
    return int(number) if number.isdigit() else -1
