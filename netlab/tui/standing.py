"""What the lab's supervisor says of itself, beside the records: processes, coming events, recording. Values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Standing:
    """A status of the lab, as far as the screen shows it. ``t_s`` is None before t = 0."""

    phase: str = "starting"
    t_s: float | None = None
    end_s: float = 0.0
    held: bool = False
    recording: str | None = None
    undo: str | None = None
    processes: tuple[Mapping[str, Any], ...] = ()
    coming: tuple[Mapping[str, Any], ...] = ()
    troubles: tuple[str, ...] = ()

    @classmethod
    def of(cls, status: Mapping[str, Any]) -> Standing:
        """From a status of the lab."""
        return cls(
            phase=str(status["phase"]),
            t_s=status["t_s"],
            end_s=float(status["end_s"]),
            held=bool(status["held"]),
            recording=status["recording"],
            undo=status["undo"],
            processes=tuple(status["processes"]),
            coming=tuple(status["coming"]),
            troubles=(*status["failures"], *status["problems"], *status["notices"]),
        )

    def processes_of(self, node: str) -> list[Mapping[str, Any]]:
        """The processes of a node."""
        return [process for process in self.processes if process["node"] == node]
