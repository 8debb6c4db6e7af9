"""The live view, asked by a client that speaks the protocol and knows nothing of netlab."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from netlab.capture.onlookers import Declaration, Onlooker
from netlab.capture.schemas import Schema, json_schema_for, log_schema
from netlab.cli import main
from netlab.errors import MachineError
from netlab.live import foxglove as view
from netlab.live.feed import Feed
from netlab.live.foxglove import FoxgloveServer

pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
sync = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")

T0_NS = 1_800_000_000_000_000_000
_DATA = struct.Struct("<BIQ")  # opcode, subscription, log time


class Source:
    """The recorder's end of a feed."""

    def __init__(self) -> None:
        self._theirs, ours = socket.socketpair()
        self.onlooker = Onlooker(ours, packets=True)
        self.channels: list[Declaration] = []

    def feed(self) -> Feed:
        return Feed(self._theirs)

    def declare(self, topic: str, schema: Schema) -> int:
        self.channels.append(Declaration(len(self.channels) + 1, topic, schema, {"node": "a"}))
        return len(self.channels)

    def send(self, channel: int, t_ns: int, data: bytes) -> None:
        self.onlooker.message(channel, t_ns, data)
        assert self.onlooker.send(self.channels)


@pytest.fixture
def source() -> Iterator[Source]:
    made = Source()
    yield made
    made.onlooker.close()


class Viewer:
    """A client that subscribes to everything."""

    def __init__(self, connection: Any) -> None:
        self._socket = connection
        self.info: dict[str, Any] = json.loads(self._socket.recv(timeout=10))
        self.channels: dict[int, dict[str, Any]] = {}

    def next(self, timeout_s: float = 10.0) -> tuple[str, int, bytes]:
        """The next message: topic, log time, data."""
        while True:
            told = self._socket.recv(timeout=timeout_s)
            if isinstance(told, bytes):
                _, number, t_ns = _DATA.unpack_from(told)
                return self.channels[number]["topic"], t_ns, told[_DATA.size :]
            event = json.loads(told)
            if event["op"] == "advertise":
                self.channels |= {channel["id"]: channel for channel in event["channels"]}
                wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in event["channels"]]
                self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


@contextlib.contextmanager
def look(port: int) -> Iterator[Viewer]:
    with sync.connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"]) as connection:
        yield Viewer(connection)


def test_a_client_gets_channels_and_messages_as_they_stand_in_the_capture(source: Source) -> None:
    logs, acts = (
        source.declare("/a/log/udp_mesh", log_schema()),
        source.declare("/timeline", json_schema_for("/timeline")),
    )
    with FoxgloveServer(source.feed(), name="pair", port=0, again_s=60.0) as server, look(server.port) as viewer:
        source.send(logs, T0_NS, b"")  # makes the channel known; nobody can have subscribed to it yet
        source.send(acts, T0_NS, b"{}")
        got = {}
        while len(got) < 2:
            source.send(logs, T0_NS + 5, b"\x1a\x02hi")
            source.send(acts, T0_NS + 7, b'{"kind":"start"}')
            with contextlib.suppress(TimeoutError):  # what was sent before it subscribed does not come
                while True:  # all that waits: one at a time would never reach what stands behind
                    topic, t_ns, data = viewer.next(timeout_s=0.2)
                    got[topic] = (t_ns, data)
        assert got == {"/a/log/udp_mesh": (T0_NS + 5, b"\x1a\x02hi"), "/timeline": (T0_NS + 7, b'{"kind":"start"}')}
        by_topic = {channel["topic"]: channel for channel in viewer.channels.values()}
        assert by_topic["/a/log/udp_mesh"]["schemaName"] == "foxglove.Log"
        assert by_topic["/a/log/udp_mesh"]["encoding"] == "protobuf"
        assert by_topic["/timeline"]["encoding"] == "json"
        assert json.loads(by_topic["/timeline"]["schema"])["type"] == "object"


def test_nobody_can_do_more_than_look(source: Source) -> None:
    with FoxgloveServer(source.feed(), name="pair", port=0) as server, look(server.port) as viewer:
        assert viewer.info["name"] == "pair"
        assert viewer.info["capabilities"] == []
        hosts = {
            line.split()[1].split(":")[0]
            for line in Path("/proc/net/tcp").read_text().splitlines()[1:]
            if int(line.split()[1].split(":")[1], 16) == server.port and line.split()[3] == "0A"
        }
        assert hosts == {"0100007F"}, "listens at 127.0.0.1 and nowhere else"


@pytest.mark.parametrize("topic", ["/map", "/nodes/scene", "/links/scene", "/mesh/scene"])
def test_who_comes_late_sees_every_scene(source: Source, topic: str) -> None:
    schema = json_schema_for(topic)
    tunnels, acts = source.declare(topic, schema), source.declare("/timeline", schema)
    with FoxgloveServer(source.feed(), name="pair", port=0, again_s=0.05) as server:
        source.send(tunnels, T0_NS, b"the map")
        source.send(acts, T0_NS, b"an act of the past")
        assert server.ended.wait(0.3) is False
        with look(server.port) as viewer:
            assert [viewer.next() for _ in range(3)] == [(topic, T0_NS, b"the map")] * 3


def test_it_ends_with_the_lab(source: Source) -> None:
    with FoxgloveServer(source.feed(), name="pair", port=0) as server:
        assert not server.ended.is_set()
        source.onlooker.close()
        assert server.ended.wait(10)


def test_a_port_that_is_taken_is_named(source: Source) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(MachineError, match=rf"127\.0\.0\.1:{port} cannot be listened at: .*choose another port"):
            FoxgloveServer(source.feed(), name="pair", port=port)


def test_without_the_sdk_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(view.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SystemExit) as ended:
        main(["foxglove"])
    assert ended.value.code == 2
    assert "pip install 'udp-mesh-lab[foxglove]'" in capsys.readouterr().err


def test_a_lab_in_a_vm_cannot_be_looked_into(capsys: pytest.CaptureFixture[str]) -> None:
    scenario = str(Path(__file__).parents[2] / "topologies" / "pair.yaml")
    with pytest.raises(SystemExit) as ended:
        main(["run", scenario, "--in", "vm", "--foxglove"])
    assert ended.value.code == 2
    assert "leave out --foxglove" in capsys.readouterr().err
