"""What a layer-2 mesh knows, as Foxglove draws it: from the daemons' lines to the messages in the file."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from netlab.capture.drawing import MESH_TOPIC
from netlab.capture.feeds import Feed, make_feed
from netlab.capture.mesh_view import MeshNode, MeshView
from netlab.capture.messages import AddFeed, FeedKind
from netlab.capture.scene import Pose, poses_message
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter

T0_NS = 1_800_000_000_000_000_000
A, R, B = (f"02:4e:4d:00:00:0{number}" for number in (1, 2, 3))
Line = Mapping[str, object]


def links(mac: str, *neighbours: str, quality: float = 0.9) -> Line:
    told = {"member": 0, "quality": quality, "cost": 1.1, "loss_ratio": 0.02, "snr_db": None, "rate_bps": 54e6}
    rows = [{"neighbour": neighbour, **told} for neighbour in neighbours]
    return {"t_ns": T0_NS, "event": "links", "mac": mac, "links": rows}


def route(destination: str, next_hop: str | None) -> Line:
    return {"t_ns": T0_NS, "event": "route_changed", "destination": destination, "next_hop": next_hop, "cost": 2.0}


class Recording:
    """A file into which daemons of nodes write lines, and the scenes that it holds in the end."""

    def __init__(self, path: Path) -> None:
        self._path, self._writer = path, CaptureWriter(path)
        self.topics = Topics(self._writer)
        self._feeds: dict[str, tuple[Feed, socket.socket]] = {}

    def daemon(self, node: str, *lines: Line, process: str = "wnet") -> None:
        if node not in self._feeds:
            theirs, ours = socket.socketpair()
            request = AddFeed(FeedKind.EVENTS, f"/{node}/{process}/events", node, process)
            self._feeds[node] = make_feed(request, theirs.detach(), self.topics, []), ours
        feed, ours = self._feeds[node]
        ours.sendall(b"".join(json.dumps(line).encode() + b"\n" for line in lines))
        assert feed.drain()

    def death(self, node: str) -> None:
        feed, ours = self._feeds.pop(node)
        ours.close()
        feed.close()

    def poses(self, **places: tuple[float, float, float]) -> None:
        told = poses_message([Pose(node, place, 0.0, True) for node, place in places.items()], 0.0)
        self.topics.add_json("/poses", told, T0_NS)

    def scenes(self) -> list[SceneUpdate]:
        """End it, and read it as any program would."""
        for node in list(self._feeds):
            self.death(node)
        self._writer.close()
        with self._path.open("rb") as file:
            found = list(make_reader(file).iter_messages([MESH_TOPIC]))
        assert {schema.name for schema, _, _ in found if schema is not None} <= {"foxglove.SceneUpdate"}
        return [SceneUpdate.FromString(message.data) for _, _, message in found]


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    return Recording(tmp_path / "run.mcap")


def line_of_three(recording: Recording) -> None:
    """a - r - b, where a sends to r and b, and r to b."""
    recording.daemon("a", links(A, R), route(R, R), route(B, R))
    recording.daemon("r", links(R, A, B, quality=0.4), route(B, B))
    recording.daemon("b", links(B, R))


def entities(scene: SceneUpdate) -> dict[str, SceneEntity]:
    return {entity.id: entity for entity in scene.entities}


def test_next_hops_are_arrows_and_other_links_lines(recording: Recording) -> None:
    line_of_three(recording)
    recording.poses(a=(0, 0, 0), r=(50, 0, 0), b=(100, 0, 0))
    recording.topics.draw(T0_NS)
    [scene] = recording.scenes()
    drawn = entities(scene)
    assert set(drawn) == {"mesh/a>r", "mesh/r>a", "mesh/r>b", "mesh/b>r"}
    assert {name for name, entity in drawn.items() if entity.arrows} == {"mesh/a>r", "mesh/r>b"}
    assert {name for name, entity in drawn.items() if entity.lines} == {"mesh/r>a", "mesh/b>r"}
    assert all(entity.frame_id == "map" and entity.lifetime.ToNanoseconds() == 0 for entity in drawn.values())
    assert {pair.key: pair.value for pair in drawn["mesh/a>r"].metadata} == {
        "quality": "0.90",
        "cost": "1.10",
        "loss_ratio": "0.020",
        "rate_bps": "54000000",
        "destinations": "b, r",
    }
    good, worse = drawn["mesh/a>r"].arrows[0].color, drawn["mesh/r>b"].arrows[0].color
    assert good.a > worse.a > 0.3, "the worse the fainter, and never unseen"


def tip(arrow: ArrowPrimitive) -> tuple[float, float, float]:
    """Where an arrow's point is: its length along x, turned by its quaternion."""
    turn, length = arrow.pose.orientation, arrow.shaft_length + arrow.head_length
    w, x, y, z = turn.w, turn.x, turn.y, turn.z
    assert math.hypot(w, x, y, z) == pytest.approx(1.0)
    ahead = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    place = arrow.pose.position
    return tuple(at + length * part for at, part in zip((place.x, place.y, place.z), ahead, strict=True))  # type: ignore[return-value]


@pytest.mark.parametrize(
    "end", [(40, 0, 0), (0, 40, 0), (-24, -32, 0), (24, 0, -32), (10, 20, 20), (0, 0, 30), (1, 0, 0)]
)
def test_arrows_point_from_node_to_node_and_keep_to_the_right(
    recording: Recording, end: tuple[float, float, float]
) -> None:
    recording.daemon("a", links(A, R), route(R, R))
    recording.daemon("r", links(R, A), route(A, A))
    recording.poses(a=(0, 0, 0), r=end)
    recording.topics.draw(T0_NS)
    [scene] = recording.scenes()
    there, back = (entities(scene)[name].arrows[0] for name in ("mesh/a>r", "mesh/r>a"))
    length_m = math.dist((0, 0, 0), end)
    assert tail(there) != pytest.approx(tip(back)), "side by side"
    for arrow, start, stop in ((there, (0, 0, 0), end), (back, end, (0, 0, 0))):
        assert math.dist(tail(arrow), start) < 2.1
        assert math.dist(tip(arrow), stop) < 2.1
        assert 0.5 * length_m < arrow.shaft_length + arrow.head_length < length_m
        along = [b - a for a, b in zip(start, stop, strict=True)]
        beside = [b - a for a, b in zip(start, tail(arrow), strict=True)]
        if any(along[:2]):
            assert along[0] * beside[1] - along[1] * beside[0] < 0, "right of its own way"


def tail(arrow: ArrowPrimitive) -> tuple[float, float, float]:
    place = arrow.pose.position
    return place.x, place.y, place.z


def test_every_scene_is_a_whole_one_and_none_comes_without_news(recording: Recording) -> None:
    line_of_three(recording)
    recording.poses(a=(0, 0, 0), r=(50, 0, 0), b=(100, 0, 0))
    recording.topics.draw(T0_NS)
    recording.daemon("a", links(A, R), route(B, R))
    recording.topics.draw(T0_NS + 1)  # nothing new was told
    recording.daemon("a", route(B, None))
    recording.topics.draw(T0_NS + 2)
    recording.topics.draw(T0_NS + 2)
    recording.daemon("r", links(R, A))
    recording.topics.draw(T0_NS + 3)
    first, second, third = recording.scenes()
    assert len(entities(first)) == len(entities(second)) == 4
    assert entities(second)["mesh/a>r"].metadata[-1].value == "r"
    assert set(entities(third)) == {"mesh/a>r", "mesh/r>a", "mesh/b>r"}
    assert [deletion.id for deletion in third.deletions] == ["mesh/r>b"]


def test_what_a_daemon_knew_ends_with_it(recording: Recording) -> None:
    line_of_three(recording)
    recording.poses(a=(0, 0, 0), r=(50, 0, 0), b=(100, 0, 0))
    recording.topics.draw(T0_NS)
    recording.death("r")
    recording.topics.draw(T0_NS + 1)
    _, scene = recording.scenes()
    assert not scene.entities
    assert len(scene.deletions) == 4


def test_a_daemon_that_begins_before_the_last_one_is_gone_keeps_its_place() -> None:
    view = MeshView()
    old, other = view.begin("a"), view.begin("r")
    view.take(other, links(R, A))
    new = view.begin("a")
    view.take(new, links(A, R))
    view.end(old)
    assert [(hop.sender, hop.receiver) for hop in view.hops()] == [("a", "r"), ("r", "a")]


@pytest.mark.parametrize(
    "lines",
    [
        pytest.param(lambda it: it.daemon("a", links(A, R), process="other"), id="no process is a mesh"),
        pytest.param(lambda it: it.daemon("a", links(A, R)), id="the neighbour is no node of the lab"),
        pytest.param(lambda it: None, id="no node has told anything"),
    ],
)
def test_captures_without_a_mesh_have_no_such_topic(recording: Recording, lines: Callable[[Recording], None]) -> None:
    lines(recording)
    recording.poses(a=(0, 0, 0), r=(50, 0, 0))
    recording.topics.draw(T0_NS)
    recording.poses(a=(1, 0, 0), r=(50, 0, 0))
    recording.topics.draw(T0_NS)
    assert not recording.scenes()


ODD = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3) | st.just(10**400),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["neighbour", "quality", "cost"]), inner)
    ),
    max_leaves=8,
)


@given(
    st.lists(
        st.fixed_dictionaries(
            {"event": st.sampled_from(["links", "route_changed"])},
            optional={"mac": ODD, "links": ODD, "destination": ODD, "next_hop": ODD},
        ),
        max_size=4,
    )
)
def test_odd_records_are_left_out(records: list[dict[str, object]]) -> None:
    view = MeshView()
    node: MeshNode = view.begin("a")
    for record in records:
        view.take(node, record)
    list(view.hops())
