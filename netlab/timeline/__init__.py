"""What happens when: a pure schedule of typed actions, compiled from a scenario's events and radio trace."""

from netlab.timeline.compiler import compile_timeline
from netlab.timeline.entries import (
    Action,
    DeployNode,
    Entry,
    KillProcess,
    Kind,
    MoveNode,
    SetCarrier,
    SetOutage,
    SetPairs,
    StartProcess,
)
from netlab.timeline.routes import MeshRoutes, carried_pairs

__all__ = [
    "Action",
    "DeployNode",
    "Entry",
    "KillProcess",
    "Kind",
    "MeshRoutes",
    "MoveNode",
    "SetCarrier",
    "SetOutage",
    "SetPairs",
    "StartProcess",
    "carried_pairs",
    "compile_timeline",
]
