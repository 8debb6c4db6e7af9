"""The lab's map and poses as messages that Foxglove draws: ``/map`` once, ``/poses`` while nodes move.

Both are Foxglove's own schemas in JSON, with keys of ours beside theirs: ``tunnels`` on the map; ``nodes``, ``active``
and ``t_s`` with the poses, in the order of ``poses``. Frame ``map``: metres, x and y on the map, z up.
Source of the shapes: the schemas SceneUpdate and PosesInFrame of foxglove-schemas.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

_FRAME = "map"
_ROCK = {"r": 0.55, "g": 0.5, "b": 0.45, "a": 0.5}
_TEXT = {"r": 0.5, "g": 0.5, "b": 0.5, "a": 1.0}
_UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_LINE_STRIP = 0

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


def map_message(passages: Iterable[Passage], t_ns: int) -> dict[str, object]:
    """A ``foxglove.SceneUpdate`` with one entity per tunnel."""
    passages = list(passages)
    return {
        "deletions": [],
        "entities": [_tunnel(passage, t_ns) for passage in passages],
        "tunnels": [
            {"name": passage.name, "path": passage.path_m, "width_m": passage.width_m, "height_m": passage.height_m}
            for passage in passages
        ],
    }


def poses_message(poses: Iterable[Pose], t_s: float, t_ns: int) -> dict[str, object]:
    """A ``foxglove.PosesInFrame``; ``t_s`` is the scenario time that the poses belong to."""
    poses = list(poses)
    return {
        "timestamp": _stamp(t_ns),
        "frame_id": _FRAME,
        "poses": [{"position": _xyz(pose.position_m), "orientation": _yaw(pose.heading_deg)} for pose in poses],
        "nodes": [pose.node for pose in poses],
        "active": [pose.active for pose in poses],
        "t_s": t_s,
    }


def _tunnel(passage: Passage, t_ns: int) -> dict[str, object]:
    middle = passage.path_m[len(passage.path_m) // 2]
    line = {
        "type": _LINE_STRIP,
        "pose": {"position": _xyz((0.0, 0.0, 0.0)), "orientation": _UPRIGHT},
        "thickness": passage.width_m,
        "scale_invariant": False,
        "points": [_xyz(point) for point in passage.path_m],
        "color": _ROCK,
        "colors": [],
        "indices": [],
    }
    text = {
        "pose": {"position": _xyz(middle), "orientation": _UPRIGHT},
        "billboard": True,
        "font_size": 12.0,
        "scale_invariant": True,
        "color": _TEXT,
        "text": passage.name,
    }
    nothing: list[object] = []
    shapes = dict.fromkeys(("arrows", "cubes", "spheres", "cylinders", "triangles", "models"), nothing)
    return {
        "timestamp": _stamp(t_ns),
        "frame_id": _FRAME,
        "id": f"tunnel/{passage.name}",
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        "metadata": [],
        "lines": [line],
        "texts": [text],
        **shapes,
    }


def _stamp(t_ns: int) -> dict[str, int]:
    return {"sec": t_ns // 1_000_000_000, "nsec": t_ns % 1_000_000_000}


def _xyz(point: Point) -> dict[str, float]:
    return {"x": round(point[0], 4), "y": round(point[1], 4), "z": round(point[2], 4)}


def _yaw(heading_deg: float) -> dict[str, float]:
    """A turn about the z axis as a quaternion."""
    half = math.radians(heading_deg) / 2.0
    return {"x": 0.0, "y": 0.0, "z": round(math.sin(half), 6), "w": round(math.cos(half), 6)}
