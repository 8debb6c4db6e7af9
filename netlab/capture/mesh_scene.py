"""The mesh as Foxglove draws it: what its daemons know and chose, beside the links of the radios themselves. Pure.

One entity per directed link of :class:`~netlab.capture.mesh_view.MeshView`, in purple, which no link of
:mod:`netlab.capture.link_scene` has: an arrow where the sender's frames leave over it, else a thin line; the worse the
mesh thinks of it, the fainter. Both directions of a pair keep to the right of the line between the two, so that neither
covers the other. Every message is a whole scene.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from netlab.capture.foxglove import Place, colour, delete, new_entity, places, points
from netlab.capture.mesh_view import Hop, MeshView

_PURPLE = (0.8, 0.47, 0.65)
_FAINTEST = 0.35
_LINE_PX = 1.0
_ASIDE_M, _ABOVE_M = 0.9, 0.3
_GAP_M, _GAP_PART = 1.5, 0.2  # at each end: room for the nodes' bodies, or this part of a short link
_SHAFT_M, _HEAD_M = 0.5, 1.6  # across
_HEAD_PART = 0.4


class MeshScene:
    """The scene as it is now."""

    def __init__(self, view: MeshView) -> None:
        self._view = view
        self._places: dict[str, Place] = {}
        self._version = view.version
        self._is_new = True
        self._drawn: set[str] = set()

    def take_poses(self, payload: Mapping[str, object]) -> None:
        """Nodes are elsewhere now; ``payload`` is a message of ``/poses``."""
        found = places(payload)
        self._is_new |= found != self._places
        self._places = found

    def message(self, t_ns: int) -> bytes | None:
        """Return the scene as a ``foxglove.SceneUpdate``; None if nothing changed, or there never was a mesh."""
        if not (self._is_new or self._version != self._view.version):
            return None
        self._is_new, self._version = False, self._view.version
        scene, drawn = SceneUpdate(), set()
        for hop in self._view.hops():
            ends = [self._places.get(node) for node in (hop.sender, hop.receiver)]
            if ends[0] is not None and ends[1] is not None and ends[0] != ends[1]:
                drawn.add(name := f"mesh/{hop.sender}>{hop.receiver}")
                _draw(scene, name, hop, ends[0], ends[1], t_ns)
        delete(scene, self._drawn - drawn, t_ns)
        self._drawn = drawn
        return bytes(scene.SerializeToString()) if scene.entities or scene.deletions else None


def _draw(scene: SceneUpdate, name: str, hop: Hop, start: Place, end: Place, t_ns: int) -> None:
    entity = new_entity(scene, name, t_ns)
    for key, value in _metadata(hop):
        entity.metadata.add(key=key, value=value)
    opacity = _FAINTEST + (1 - _FAINTEST) * hop.link.quality
    tail, length_m = _shortened(start, end)
    if hop.destinations:
        head_m = min(_HEAD_M, _HEAD_PART * length_m)
        arrow = entity.arrows.add(color=colour((*_PURPLE, opacity)))
        arrow.pose.CopyFrom(_along(start, end, tail))
        arrow.shaft_length, arrow.shaft_diameter = length_m - head_m, _SHAFT_M
        arrow.head_length, arrow.head_diameter = head_m, _HEAD_M
    else:
        line = entity.lines.add(type=LinePrimitive.LINE_LIST, scale_invariant=True, thickness=_LINE_PX)
        line.pose.CopyFrom(_along(start, end, tail))
        line.points.extend(points(((0, 0, 0), (length_m, 0, 0))))
        line.color.CopyFrom(colour((*_PURPLE, opacity)))


def _metadata(hop: Hop) -> list[tuple[str, str]]:
    link = hop.link
    figures = (
        ("cost", link.cost, ".2f"),
        ("loss_ratio", link.loss_ratio, ".3f"),
        ("snr_db", link.snr_db, ".1f"),
        ("rate_bps", link.rate_bps, ".0f"),
    )
    told = [(key, format(value, form)) for key, value, form in figures if value is not None]
    to = [("destinations", ", ".join(hop.destinations))] if hop.destinations else []
    return [("quality", f"{link.quality:.2f}"), *told, *to]


def _shortened(start: Place, end: Place) -> tuple[Place, float]:
    """Where what is drawn between two nodes begins, and its length in metres."""
    whole_m = math.dist(start, end)
    gap_m = min(_GAP_M, _GAP_PART * whole_m)
    dx, dy, dz = ((b - a) / whole_m for a, b in zip(start, end, strict=True))
    flat = math.hypot(dx, dy)
    right = (dy / flat, -dx / flat) if flat else (math.copysign(1.0, dz), 0.0)
    x, y, z = start
    aside = (x + dx * gap_m + right[0] * _ASIDE_M, y + dy * gap_m + right[1] * _ASIDE_M, z + dz * gap_m + _ABOVE_M)
    return aside, whole_m - 2 * gap_m


def _along(start: Place, end: Place, tail: Place) -> Pose:
    """A pose at ``tail`` whose x axis points as from ``start`` to ``end``: a turn about y, then one about z."""
    dx, dy, dz = (b - a for a, b in zip(start, end, strict=True))
    yaw, pitch = math.atan2(dy, dx) / 2, -math.atan2(dz, math.hypot(dx, dy)) / 2
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = tail
    turn = pose.orientation
    turn.w, turn.x = math.cos(yaw) * math.cos(pitch), -math.sin(yaw) * math.sin(pitch)
    turn.y, turn.z = math.cos(yaw) * math.sin(pitch), math.sin(yaw) * math.cos(pitch)
    return pose
