"""The lab's map and poses as plain values, as the lab hands them to its recorder: ``/map`` once, ``/poses`` in motion.

Metres, x and y on the map, z up. What they become in the file is the business of :mod:`netlab.capture.foxglove`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Passage:
    """One tunnel on the map."""

    name: str
    path_m: Sequence[Point]
    width_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class Pose:
    """One node: where it is, where it looks (degrees counter-clockwise from x), and whether it takes part."""

    node: str
    position_m: Point
    heading_deg: float
    active: bool


def map_message(passages: Iterable[Passage]) -> dict[str, object]:
    """The tunnels."""
    return {
        "tunnels": [
            {"name": passage.name, "path": passage.path_m, "width_m": passage.width_m, "height_m": passage.height_m}
            for passage in passages
        ],
    }


def poses_message(poses: Iterable[Pose], t_s: float) -> dict[str, object]:
    """Where everybody is at scenario time ``t_s``; ``nodes`` names the ``poses``, ``active`` tells who takes part."""
    poses = list(poses)
    return {
        "poses": [{"position": _xyz(pose.position_m), "orientation": _yaw(pose.heading_deg)} for pose in poses],
        "nodes": [pose.node for pose in poses],
        "active": [pose.active for pose in poses],
        "t_s": t_s,
    }


def _xyz(point: Point) -> dict[str, float]:
    return {"x": round(point[0], 4), "y": round(point[1], 4), "z": round(point[2], 4)}


def _yaw(heading_deg: float) -> dict[str, float]:
    """A turn about the z axis as a quaternion."""
    half = math.radians(heading_deg) / 2.0
    return {"x": 0.0, "y": 0.0, "z": round(math.sin(half), 6), "w": round(math.cos(half), 6)}
