"""What happens when: a pure schedule of typed actions, compiled from a scenario's events and radio trace."""

from netlab.timeline.compiler import compile_timeline
from netlab.timeline.entries import (
    Action,
    Entry,
    KillProcess,
    Kind,
    SetCarrier,
    SetOutage,
    SetPairs,
    StartProcess,
)

__all__ = [
    "Action",
    "Entry",
    "KillProcess",
    "Kind",
    "SetCarrier",
    "SetOutage",
    "SetPairs",
    "StartProcess",
    "compile_timeline",
]
