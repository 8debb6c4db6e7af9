"""The SubT final's capture, opened with what Foxglove publishes for reading MCAP and its own schemas; virtual time."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.unknown_fields import UnknownFieldSet
from mcap.reader import McapReader, make_reader
from mcap_protobuf.schema import build_file_descriptor_set

from netlab.pytest_plugin import MakeLab

pytestmark = pytest.mark.lab_clock("virtual")

SCENARIO = Path(__file__).parents[2] / "topologies" / "subt_final.yaml"
KNOWN: dict[str, Any] = {message.DESCRIPTOR.full_name: message for message in (SceneUpdate, FrameTransforms, Log)}
ROBOTS = {"base", "spot1", "spot2", "husky1", "husky2"}
TUNNELS = {"portal", "north", "south", "station", "cave", "deep"}


def test_an_independent_reader_finds_what_foxglove_draws(make_lab: MakeLab) -> None:
    lab = make_lab(SCENARIO, overrides=["duration=6s", "mesh=flood"], packets=False)
    lab.run()
    with lab.capture.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        check_schemas(reader)
        messages = decoded(reader)
        assert "foxglove-layout.json" in {attachment.name for attachment in reader.iter_attachments()}
    counts = Counter({topic: len(found) for topic, found in messages.items()})
    assert counts["/map"] == 1
    assert counts["/poses"] >= 55, "ten times a second"
    assert 4 <= counts["/links/scene"] <= 9, "about once a second"
    transforms = [transform for message in messages["/poses"] for transform in message.transforms]
    frames = {transform.child_frame_id: transform.parent_frame_id for transform in transforms}
    assert {name for name, parent in frames.items() if parent == "map"} == ROBOTS
    assert {parent for name, parent in frames.items() if name not in ROBOTS} == {"carried"}
    assert entities(messages["/map"][0]) == {f"tunnel/{name}" for name in TUNNELS}
    assert entities(messages["/nodes/scene"][0]) > {f"node/{name}" for name in ROBOTS}
    assert "link/base-spot1/radio" in entities(messages["/links/scene"][-1])


def check_schemas(reader: McapReader) -> None:
    """Every Foxglove schema of the file is the published one, to the byte."""
    summary = reader.get_summary()
    assert summary is not None
    schemas = [schema for schema in summary.schemas.values() if schema.name.startswith("foxglove.")]
    assert {schema.name for schema in schemas} >= {"foxglove.SceneUpdate", "foxglove.FrameTransforms"}
    for schema in schemas:
        assert schema.encoding == "protobuf"
        assert schema.data == build_file_descriptor_set(KNOWN[schema.name]).SerializeToString(), schema.name


def decoded(reader: McapReader) -> dict[str, list[Any]]:
    """Every message of a Foxglove schema, by topic; none holds anything that its schema does not know."""
    found: dict[str, list[Any]] = {}
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if schema is not None and schema.name in KNOWN:
            told = KNOWN[schema.name].FromString(message.data)
            assert told.ByteSize() > 0, channel.topic
            assert len(UnknownFieldSet(told)) == 0, channel.topic
            found.setdefault(channel.topic, []).append(told)
    return found


def entities(scene: SceneUpdate) -> set[str]:
    """What a scene is made of."""
    return {entity.id for entity in scene.entities}
