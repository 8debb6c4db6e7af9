"""What a timeline consists of: typed actions at scenario times. Values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from netlab.medium.impairments import Impairment

Pair = tuple[int, int]  # (sender port, receiver port)


class Kind(StrEnum):
    """What happens, for records and screens."""

    OUTAGE = "outage"
    OUTAGE_END = "outage_end"
    FLAP_DOWN = "flap_down"
    FLAP_UP = "flap_up"
    LINK = "link"
    TRACE = "trace"
    KILL = "kill"
    START = "start_process"
    DEPLOY = "deploy"
    MOVE = "move"
    RADIO = "radio"
    MARK = "mark"
    HOLD = "hold"
    RESUME = "resume"


@dataclass(frozen=True, slots=True)
class SetPairs:
    """Give these pairs new impairments; None takes a pair out of range."""

    changes: Mapping[Pair, Impairment | None]


@dataclass(frozen=True, slots=True)
class SetOutage:
    """Lose everything on these pairs silently, or end that."""

    pairs: frozenset[Pair]
    active: bool


@dataclass(frozen=True, slots=True)
class SetCarrier:
    """Pull or plug the cables at these ports."""

    ports: frozenset[int]
    up: bool


@dataclass(frozen=True, slots=True)
class KillProcess:
    """SIGKILL to a process of a node."""

    node: str
    process: str


@dataclass(frozen=True, slots=True)
class StartProcess:
    """Start a process of a node again."""

    node: str
    process: str


@dataclass(frozen=True, slots=True)
class DeployNode:
    """Drop a node that was carried: it lies there from now on, on the air (all its pairs), and its processes start."""

    node: str
    pairs: frozenset[Pair]


@dataclass(frozen=True, slots=True)
class MoveNode:
    """A node leaves its motion for another place; who reads the motions knows where it is."""

    node: str


@dataclass(frozen=True, slots=True)
class Nothing:
    """Only the record matters."""


@dataclass(frozen=True, slots=True)
class HoldMotion:
    """Let everybody's motion stand still, or go on."""

    active: bool


Action = SetPairs | SetOutage | SetCarrier | KillProcess | StartProcess | DeployNode | MoveNode | Nothing | HoldMotion


@dataclass(frozen=True, slots=True)
class Entry:
    """One action at ``at_s`` seconds of scenario time.

    ``restores`` names the two nodes that nothing scheduled keeps apart any more, when this entry ended the last of it.
    Of nodes in a mesh, ``reroutes`` names the ends of streams that still have a path after this cut, ``rejoins`` those
    that have one again. ``event`` is the event's place in the scenario's `events`, None for a row of a radio trace.
    """

    at_s: float
    kind: Kind
    label: str
    action: Action
    restores: tuple[str, str] | None = None
    reroutes: tuple[tuple[str, str], ...] = ()
    rejoins: tuple[tuple[str, str], ...] = ()
    event: int | None = field(default=None, compare=False)
