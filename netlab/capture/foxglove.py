"""The lab's map and poses as messages that Foxglove draws with nothing installed, and back again. Values only.

``/map`` is a ``foxglove.SceneUpdate`` with one entity per tunnel, ``/poses`` a ``foxglove.FrameTransforms`` with the
frame of each node, whose name it has, in the frame ``map``: metres, x and y on the map, z up. ``/nodes/scene`` gives
each node a body and a name in its own frame, so that they go where it goes. In protobuf, as published with
foxglove-sdk. The frame of a node that is still carried is below ``carried`` instead, which has no place on the map.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from mcap_protobuf.schema import build_file_descriptor_set

from netlab.capture.schemas import Schema

FRAME = "map"
CARRIED = "carried"
ROCK = (0.55, 0.5, 0.45, 0.5)
TEXT = (0.5, 0.5, 0.5, 1.0)
_NODE = (0.84, 0.37, 0.0, 1.0)
_NODE_M = 1.6  # across: to be seen on a map of hundreds of metres
_TUNNEL = "tunnel/"
Payload = dict[str, object]
Place = tuple[float, float, float]


def scene_schema() -> Schema:
    """``foxglove.SceneUpdate``."""
    return _schema(SceneUpdate)


def transforms_schema() -> Schema:
    """``foxglove.FrameTransforms``."""
    return _schema(FrameTransforms)


def _schema(message: type[Message]) -> Schema:
    data = build_file_descriptor_set(message).SerializeToString()
    return Schema(message.DESCRIPTOR.full_name, "protobuf", "protobuf", data)


def encode_map(payload: Mapping[str, object], t_ns: int) -> bytes:
    """Encode ``tunnels`` (name, path in metres, width_m, height_m) as one entity each."""
    scene = SceneUpdate()
    tunnels = payload["tunnels"]
    assert isinstance(tunnels, list)
    for tunnel in tunnels:
        entity = new_entity(scene, _TUNNEL + tunnel["name"], t_ns)
        for key in ("width_m", "height_m"):
            entity.metadata.add(key=key, value=repr(tunnel[key]))
        line = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=tunnel["width_m"], color=colour(ROCK))
        line.pose.CopyFrom(_nowhere())
        line.points.extend(points(tunnel["path"]))
        _label(entity, tunnel["name"], tunnel["path"][len(tunnel["path"]) // 2], 12.0)
    return bytes(scene.SerializeToString())


def decode_map(data: bytes) -> Payload:
    """Return ``tunnels`` again. Raises DecodeError or ValueError on damaged data."""
    tunnels = []
    for entity in SceneUpdate.FromString(data).entities:
        if not entity.id.startswith(_TUNNEL) or len(entity.lines) != 1:
            continue
        sizes = {pair.key: float(pair.value) for pair in entity.metadata}
        path = [[point.x, point.y, point.z] for point in entity.lines[0].points]
        tunnels.append({"name": entity.id.removeprefix(_TUNNEL), "path": path, **sizes})
    return {"tunnels": tunnels}


def encode_poses(payload: Mapping[str, object], stamp_ns: int) -> bytes:
    """Encode ``nodes`` and ``poses``; who is not ``active`` hangs in a tree of its own, which nothing draws.

    ``stamp_ns`` is when they are there.
    """
    update = FrameTransforms()
    for node, pose, is_active in _all(payload):
        transform = update.transforms.add(parent_frame_id=FRAME if is_active else CARRIED, child_frame_id=node)
        transform.timestamp.FromNanoseconds(stamp_ns)
        for axis, value in pose["position"].items():
            setattr(transform.translation, axis, value)
        for axis, value in pose["orientation"].items():
            setattr(transform.rotation, axis, value)
    return bytes(update.SerializeToString())


def decode_poses(data: bytes) -> Payload:
    """Return ``nodes``, ``poses``, ``active`` and ``stamp_ns`` again. Raises DecodeError on damaged data."""
    transforms = FrameTransforms.FromString(data).transforms
    poses = []
    for transform in transforms:
        place, turn = transform.translation, transform.rotation
        position = {"x": place.x, "y": place.y, "z": place.z}
        poses.append({"position": position, "orientation": {"x": turn.x, "y": turn.y, "z": turn.z, "w": turn.w}})
    return {
        "nodes": [transform.child_frame_id for transform in transforms],
        "poses": poses,
        "active": [transform.parent_frame_id == FRAME for transform in transforms],
        "stamp_ns": max((transform.timestamp.ToNanoseconds() for transform in transforms), default=0),
    }


def encode_nodes(nodes: Sequence[str], t_ns: int) -> bytes:
    """Encode a body and a name for each node, in its own frame."""
    scene = SceneUpdate()
    for node in nodes:
        entity = new_entity(scene, f"node/{node}", t_ns, frame=node)
        entity.frame_locked = True
        body = entity.spheres.add(color=colour(_NODE))
        body.pose.CopyFrom(_nowhere())
        body.size.x = body.size.y = body.size.z = _NODE_M
        _label(entity, node, (0.0, 0.0, 2 * _NODE_M), 14.0)
    return bytes(scene.SerializeToString())


def present(payload: Mapping[str, object]) -> list[tuple[str, dict[str, dict[str, float]]]]:
    """The nodes that take part, and the pose of each."""
    return [(node, pose) for node, pose, is_active in _all(payload) if is_active]


def places(payload: Mapping[str, object]) -> dict[str, Place]:
    """Where the nodes that take part are; ``payload`` is a message of ``/poses``."""
    return {node: _place(pose["position"]) for node, pose in present(payload)}


def _place(position: Mapping[str, float]) -> Place:
    return position["x"], position["y"], position["z"]


def _all(payload: Mapping[str, object]) -> list[tuple[str, dict[str, dict[str, float]], bool]]:
    nodes, poses, active = (payload.get(key) for key in ("nodes", "poses", "active"))
    assert isinstance(nodes, list)
    assert isinstance(poses, list)
    takes_part = active if isinstance(active, list) else [True] * len(nodes)
    return list(zip(nodes, poses, takes_part, strict=True))


def new_entity(scene: SceneUpdate, name: str, t_ns: int, *, frame: str = FRAME) -> SceneEntity:
    """Add an entity that stays until it is replaced."""
    entity = scene.entities.add(id=name, frame_id=frame)
    entity.timestamp.FromNanoseconds(t_ns)
    entity.lifetime.FromNanoseconds(0)
    return entity


def delete(scene: SceneUpdate, names: Iterable[str], t_ns: int) -> None:
    """Have entities of earlier messages disappear."""
    for name in sorted(names):
        deletion = scene.deletions.add(type=SceneEntityDeletion.MATCHING_ID, id=name)
        deletion.timestamp.FromNanoseconds(t_ns)


def points(path: Iterable[Sequence[float]]) -> list[Point3]:
    """Places in metres."""
    return [Point3(x=x, y=y, z=z) for x, y, z in path]


def colour(rgba: tuple[float, float, float, float]) -> Color:
    """Red, green, blue and opacity, each 0..1."""
    red, green, blue, alpha = rgba
    return Color(r=red, g=green, b=blue, a=alpha)


def _nowhere() -> Pose:
    """No displacement and no turn; a quaternion of nothing but zeros would be none."""
    pose = Pose()
    pose.orientation.w = 1.0
    return pose


def _label(entity: SceneEntity, text: str, place: Sequence[float], font_size: float) -> None:
    label = entity.texts.add(text=text, billboard=True, font_size=font_size, scale_invariant=True, color=colour(TEXT))
    label.pose.CopyFrom(_nowhere())
    label.pose.position.x, label.pose.position.y, label.pose.position.z = place
