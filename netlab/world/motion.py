"""How nodes are meant to move: walks, followers, carried nodes, samples, moves. Values only; the tracks that they make
are built in :mod:`netlab.world.choreography`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

Point = tuple[float, float, float]

NEVER_S = math.inf


class OffTunnel(ValueError):
    """A position in the rock, or two that no tunnel joins; the text is for a person, without a name in front."""


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A place [x, y] or [x, y, z] to go to at ``speed_mps`` (above 0), and to stay at for ``pause_s``."""

    position_m: tuple[float, ...]
    speed_mps: float
    pause_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Walk:
    """Stand at ``start_m`` for ``pause_s``, then go from waypoint to waypoint; without any, stay."""

    start_m: tuple[float, ...]
    waypoints: tuple[Waypoint, ...] = ()
    pause_s: float = 0.0
    heading_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Follow:
    """Go where ``leader`` went, ``distance_m`` behind along its path."""

    leader: str
    distance_m: float


@dataclass(frozen=True, slots=True)
class Carried:
    """Be carried by ``carrier`` until ``deployed_at_s``, then lie there; NEVER_S: to the end."""

    carrier: str
    deployed_at_s: float = NEVER_S


@dataclass(frozen=True, slots=True)
class Sampled:
    """Known places at known times that rise."""

    times_s: tuple[float, ...]
    points_m: tuple[tuple[float, ...], ...]


Motion = Walk | Follow | Carried | Sampled


@dataclass(frozen=True, slots=True)
class Move:
    """At ``at_s`` the node leaves its motion and goes to a place at ``speed_mps``, or is there at once (None)."""

    at_s: float
    node: str
    to_m: tuple[float, ...]
    speed_mps: float | None = None


class MotionError(ValueError):
    """A motion that cannot be; the text is for a person. ``index`` counts waypoints, samples or moves by ``part``."""

    def __init__(self, node: str, text: str, *, part: str = "", index: int | None = None) -> None:
        super().__init__(text)
        self.node = node
        self.part = part
        self.index = index
