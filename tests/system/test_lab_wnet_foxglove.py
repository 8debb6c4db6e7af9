"""A wnet mesh as Foxglove sees it: the capture opened with nothing but mcap and the published schemas."""

from __future__ import annotations

from typing import Any

from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from mcap_protobuf.schema import build_file_descriptor_set

from netlab.pytest_plugin import MakeLab

KILLED_S = 3.0
DIAMOND: dict[str, Any] = {
    "duration": "6s",
    "mesh": "wnet",
    "nodes": {
        "a": {"position": [0, 0], "processes": ["udp_mesh"]},
        "r1": {"position": [50, 20]},
        "r2": {"position": [50, -20]},
        "b": {"position": [100, 0], "processes": ["udp_mesh"]},
    },
    "links": [
        *({"between": ["a", relay], "delay": "1ms"} for relay in ("r1", "r2")),
        {"between": ["r1", "b"], "delay": "1ms"},
        {"between": ["r2", "b"], "delay": "1ms", "loss": "10%"},
    ],
    "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "20Hz"}],
    "events": [{"at": f"{KILLED_S}s", "kill": {"node": "r1", "process": "wnet"}}],
}


def test_the_routes_in_use_are_arrows_that_go_another_way_when_the_relay_dies(make_lab: MakeLab) -> None:
    lab = make_lab(DIAMOND)
    lab.run()
    scenes: list[tuple[int, SceneUpdate]] = []
    with lab.capture.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, _, message in reader.iter_messages(["/mesh/scene"]):
            assert schema is not None
            assert (schema.name, schema.encoding) == ("foxglove.SceneUpdate", "protobuf")
            assert schema.data == build_file_descriptor_set(SceneUpdate).SerializeToString()
            scenes.append((message.log_time, SceneUpdate.FromString(message.data)))
        t0_ns = max(int(record.metadata.get("t0_ns", 0)) for record in reader.iter_metadata())
    before = [scene for t_ns, scene in scenes if t_ns < t0_ns + KILLED_S * 1e9][-1]
    last = scenes[-1][1]
    assert {("a", "r1"), ("r1", "b")} <= arrows(before)
    assert {("a", "r2"), ("r2", "b")} <= arrows(last)
    assert not any("r1" in ends for ends in arrows(last)), "what a dead daemon knew is gone, and who knew of it"
    drawn = {entity.id: entity for entity in before.entities}
    assert set(drawn) >= {"mesh/a>r2", "mesh/r2>a"}, "the mesh knows the second way all along"
    assert "b" in told(drawn["mesh/r1>b"], "destinations").split(", ")
    assert float(told(drawn["mesh/a>r1"], "quality")) > 0.9


def arrows(scene: SceneUpdate) -> set[tuple[str, ...]]:
    """Sender and next hop of every arrow."""
    return {tuple(entity.id.removeprefix("mesh/").split(">")) for entity in scene.entities if entity.arrows}


def told(entity: SceneEntity, key: str) -> str:
    return {pair.key: pair.value for pair in entity.metadata}[key]
