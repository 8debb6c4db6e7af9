"""Places and links as Foxglove draws them: the published schemas, and what stands in the messages."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import DescriptorProto, FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st

from netlab.capture import foxglove
from netlab.capture.drawing import LINKS_TOPIC, MESH_TOPIC, NODES_TOPIC
from netlab.capture.layout import LAYOUT_NAME, foxglove_layout, layout_file
from netlab.capture.link_scene import LinkScene, blend, quality
from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind
from netlab.capture.scene import Passage, Pose, map_message, poses_message
from netlab.capture.schemas import Schema, log_schema
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.scenario import load_scenario

T0_NS = 1_800_000_000_000_000_000
METRES = st.floats(-1000, 1000).map(lambda value: round(value, 4))
PLACES = st.tuples(METRES, METRES, METRES)


def without_json_names(data: bytes) -> bytes:
    """A descriptor set as it was before its compiler added what follows from the rest."""
    files = FileDescriptorSet.FromString(data)

    def strip(message: DescriptorProto) -> None:
        for field in message.field:
            field.ClearField("json_name")
        for nested in message.nested_type:
            strip(nested)

    for file in files.file:
        file.ClearField("source_code_info")
        for message in file.message_type:
            strip(message)
    return bytes(files.SerializeToString(deterministic=True))


@pytest.mark.parametrize("schema", [foxglove.scene_schema(), foxglove.transforms_schema(), log_schema()])
def test_the_schemas_are_those_that_foxglove_publishes(schema: Schema) -> None:
    messages = pytest.importorskip("foxglove.messages", reason="the extra `foxglove` is not installed")
    published = getattr(messages, schema.name.removeprefix("foxglove.")).get_schema()
    assert (published.name, published.encoding) == (schema.name, schema.encoding)
    assert without_json_names(published.data) == without_json_names(schema.data)


@given(st.lists(PLACES, min_size=1, max_size=5), st.floats(0.1, 50), st.floats(0.1, 50), st.text(min_size=1))
def test_a_map_comes_back(path: list[tuple[float, float, float]], width_m: float, height_m: float, name: str) -> None:
    told = map_message([Passage(name, path, width_m, height_m)])
    [tunnel] = foxglove.decode_map(foxglove.encode_map(told, T0_NS))["tunnels"]  # type: ignore[misc]
    assert tunnel == {"name": name, "path": [list(point) for point in path], "width_m": width_m, "height_m": height_m}


def test_a_tunnel_is_a_line_as_wide_as_itself_with_its_name() -> None:
    told = map_message([Passage("adit", ((0, 0, 0), (30, 0, 0)), 4.0, 3.0)])
    [entity] = SceneUpdate.FromString(foxglove.encode_map(told, T0_NS)).entities
    assert (entity.frame_id, entity.id, entity.lifetime.ToNanoseconds()) == ("map", "tunnel/adit", 0)
    assert (entity.lines[0].type, entity.lines[0].thickness) == (LinePrimitive.LINE_STRIP, 4.0)
    assert entity.lines[0].color.a > 0, "what has no opacity is not seen"
    assert entity.lines[0].pose.orientation.w == 1.0, "no turn is a quaternion too"
    assert entity.texts[0].text == "adit"


@given(st.lists(st.tuples(PLACES, st.booleans()), max_size=6))
def test_poses_come_back(told: list[tuple[tuple[float, float, float], bool]]) -> None:
    poses = [Pose(f"n{number}", place, 90.0, active) for number, (place, active) in enumerate(told)]
    message = poses_message(poses, 2.5)
    back = foxglove.decode_poses(foxglove.encode_poses(message, T0_NS))
    assert {key: back[key] for key in ("nodes", "poses", "active")} == {
        key: message[key] for key in ("nodes", "poses", "active")
    }
    assert back["stamp_ns"] == (T0_NS if told else 0)


def test_a_node_is_a_child_of_the_map_with_a_body_in_its_own_frame() -> None:
    poses = poses_message([Pose("robot1", (3, 4, 0), 0.0, True), Pose("relay", (0, 0, 0), 0.0, False)], 0.0)
    transforms = FrameTransforms.FromString(foxglove.encode_poses(poses, T0_NS)).transforms
    assert [(one.parent_frame_id, one.child_frame_id) for one in transforms] == [
        ("map", "robot1"),
        ("carried", "relay"),
    ]
    bodies = SceneUpdate.FromString(foxglove.encode_nodes(["robot1", "relay"], T0_NS)).entities
    assert [(body.frame_id, body.frame_locked, body.texts[0].text) for body in bodies] == [
        ("robot1", True, "robot1"),
        ("relay", True, "relay"),
    ]
    assert all(body.spheres[0].size.x > 0 and body.spheres[0].color.a == 1 for body in bodies)


def link(sender: str, receiver: str, state: str = "up", **more: object) -> dict[str, object]:
    return {"segment": "radio", "from": sender, "to": receiver, "state": state, **more}


def scene_of(*rows: dict[str, object]) -> LinkScene:
    scene = LinkScene()
    scene.take_poses(poses_message([Pose("a", (0, 0, 0), 0.0, True), Pose("b", (10, 0, 0), 0.0, True)], 0.0))
    for row in rows:
        scene.take_link(row)
    return scene


def drawn(scene: LinkScene) -> SceneUpdate:
    data = scene.message(T0_NS)
    assert data is not None
    return SceneUpdate.FromString(data)


def test_a_link_is_one_line_coloured_by_its_worse_direction() -> None:
    [entity] = drawn(scene_of(link("a", "b", snr_db=40.0), link("b", "a", snr_db=5.0))).entities
    assert (entity.id, entity.frame_id) == ("link/a-b/radio", "map")
    [line] = entity.lines
    assert line.type == LinePrimitive.LINE_LIST
    assert line.scale_invariant
    assert [(point.x, point.y) for point in line.points] == [(0, 0), (10, 0)]
    assert (line.color.r, line.color.g, line.color.b) == pytest.approx(blend(0.0))
    assert {pair.key: pair.value for pair in entity.metadata} == {"state": "up", "quality": "0.00", "snr_db": "5.0"}


def test_a_link_that_is_held_down_is_dashed_and_one_out_of_range_is_gone() -> None:
    scene = scene_of(link("a", "b"), link("b", "a"))
    assert len(drawn(scene).entities[0].lines[0].points) == 2
    scene.take_link(link("a", "b", "outage"))
    points = drawn(scene).entities[0].lines[0].points
    assert len(points) == 16
    assert (points[0].x, points[-1].x) == (0, 10)
    scene.take_link(link("a", "b", "out_of_range"))
    scene.take_link(link("b", "a", "out_of_range"))
    update = drawn(scene)
    assert not update.entities
    assert [deletion.id for deletion in update.deletions] == ["link/a-b/radio"]


def test_every_scene_is_a_whole_one_and_none_comes_without_news() -> None:
    scene = scene_of(link("a", "b"), link("b", "a"))
    assert len(drawn(scene).entities) == 1
    assert scene.message(T0_NS) is None
    scene.take_link(link("a", "b"))
    assert scene.message(T0_NS) is None, "nothing has changed"
    scene.take_poses(poses_message([Pose("a", (1, 0, 0), 0.0, True), Pose("b", (10, 0, 0), 0.0, True)], 0.0))
    assert drawn(scene).entities[0].lines[0].points[0].x == 1


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ({"state": "outage", "snr_db": 40.0}, 0.0),
        ({"state": "up", "snr_db": 17.5}, 0.5),
        ({"state": "up", "impairment": None}, 1.0),
        ({"state": "up", "impairment": {"loss": None}}, 1.0),
        ({"state": "up", "impairment": {"loss": {"loss_ratio": 0.05, "correlation": 0.0}}}, 0.9),
        ({"state": "up", "impairment": {"loss": {"p": 0.1, "r": 0.3, "loss_in_bad": 1.0, "loss_in_good": 0.0}}}, 0.5),
        ({"state": "up", "impairment": {"loss": {"every": 3}}}, 0.5),
    ],
)
def test_quality_is_told_by_the_signal_or_else_by_the_loss(row: dict[str, object], expected: float) -> None:
    assert quality(row) == pytest.approx(expected)


def test_a_file_holds_what_is_drawn_beside_what_is_told(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = CaptureWriter(path)
    topics = Topics(writer)
    for row in (link("a", "b"), link("b", "a")):
        topics.add_json("/links", row, T0_NS)  # before any place is known
    topics.t0_ns = T0_NS
    poses = [Pose("a", (0, 0, 0), 0.0, True), Pose("b", (5, 0, 0), 0.0, True)]
    topics.add_json("/poses", poses_message(poses, 0.1), T0_NS + 100_400_000)
    topics.draw(T0_NS + 200_000_000)
    topics.draw(T0_NS + 300_000_000)
    writer.close()
    with Capture.open(path) as capture:
        assert capture.counts() == {"/links": 2, "/poses": 1, NODES_TOPIC: 1, LINKS_TOPIC: 1}
        [record] = capture.records({Kind.POSES})
        assert isinstance(record, JsonRecord)
        assert record.payload["stamp_ns"] == T0_NS + 100_000_000, "at its own time, not at that of the message"
        assert [record.kind for record in capture.records()] == [Kind.LINKS, Kind.LINKS, Kind.POSES]


def test_the_layout_in_the_docs_is_that_of_the_default_topology() -> None:
    root = Path(__file__).parents[2]
    scenario = load_scenario(root / "topologies" / "default.yaml")
    keys = {
        "stream": "index",
        "source": "source",
        "destination": "destination",
        "topic": "topic",
        "priority": "priority",
    }
    streams = [{key: getattr(stream, name) for key, name in keys.items()} for stream in scenario.streams()]
    assert (root / "docs" / LAYOUT_NAME).read_bytes() == layout_file({"streams": json.dumps(streams)})


def test_the_layout_names_panels_and_topics_of_the_run() -> None:
    streams = '[{"stream": 3, "source": "robot1", "destination": "base", "topic": "telemetry", "priority": 1}]'
    layout = foxglove_layout({"streams": streams})
    panels = layout["configById"]
    assert isinstance(panels, dict)

    def named(part: object) -> set[str]:
        return {part} if isinstance(part, str) else named(part["first"]) | named(part["second"])  # type: ignore[index]

    assert named(layout["layout"]) == set(panels)
    assert set(panels["3D!map"]["topics"]) == {"/map", NODES_TOPIC, LINKS_TOPIC, MESH_TOPIC}
    assert panels["Plot!latency"]["paths"][0]["value"] == "/base/traffic/received{stream==3}.latency_s"
    assert panels["StateTransitions!links"]["paths"][0]["value"] == '/links{from=="robot1"}{to=="base"}.state'
