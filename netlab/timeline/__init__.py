"""What happens when: a pure schedule of typed actions, compiled from a scenario's events and radio trace."""

from netlab.timeline.compiler import compile_timeline
from netlab.timeline.entries import (
    Action,
    DeployNode,
    Entry,
    HoldMotion,
    KillProcess,
    Kind,
    MoveNode,
    Nothing,
    SetCarrier,
    SetOutage,
    SetPairs,
    StartProcess,
)
from netlab.timeline.routes import MeshRoutes, carried_pairs
from netlab.timeline.schedule import Schedule

__all__ = [
    "Action",
    "DeployNode",
    "Entry",
    "HoldMotion",
    "KillProcess",
    "Kind",
    "MeshRoutes",
    "MoveNode",
    "Nothing",
    "Schedule",
    "SetCarrier",
    "SetOutage",
    "SetPairs",
    "StartProcess",
    "carried_pairs",
    "compile_timeline",
]
