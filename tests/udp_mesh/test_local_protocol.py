"""Frames between applications and the daemon, both ends against each other and against garbage."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh import local_wire
from udp_mesh.core.settings import Keep, Offline, Reliability, TopicPolicy
from udp_mesh.frame_reader import FrameReader
from udp_mesh.io.local_socket import SocketInUse
from udp_mesh.io.server import MAX_WAITING_BYTES, Connection, LocalServer
from udp_mesh.local_wire import FrameType, LocalProtocolError, Message, Overrides, Publish, Verdict


def feed(reader: FrameReader, data: bytes) -> list[tuple[int, memoryview]]:
    """Let a reader receive these bytes; at once, as far as it has room."""
    frames, rest = [], memoryview(data)
    while rest:
        buffer = reader.buffer()
        size = min(len(rest), len(buffer))
        buffer[:size] = rest[:size]
        frames += reader.filled(size)
        rest = rest[size:]
    return frames


overrides = st.builds(
    Overrides,
    st.none() | st.integers(0, 255),
    st.none() | st.sampled_from(Reliability),
    st.none() | st.sampled_from(Keep),
    st.none() | st.sampled_from(Offline),
    st.none() | st.floats(0.001, 1e9) | st.just(float("inf")),
)
names = st.text(min_size=1, max_size=60)


@given(
    st.builds(
        Publish,
        st.integers(0, 0xFFFFFFFF),
        names,
        st.binary(max_size=300),
        names,
        overrides,
        st.booleans(),
        st.booleans(),
        st.booleans(),
    ),
    st.integers(1, 50),
)
def test_a_publish_survives_being_cut_into_pieces(publish: Publish, piece: int) -> None:
    data = local_wire.encode_publish(publish) * 2
    reader = FrameReader()
    frames = [frame for at in range(0, len(data), piece) for frame in feed(reader, data[at : at + piece])]
    assert [kind for kind, _body in frames] == [FrameType.PUBLISH] * 2
    assert [local_wire.decode_publish(body) for _kind, body in frames] == [publish] * 2


@given(
    st.lists(st.sampled_from([0, 1, 100, 32_763, 32_768, 65_530, 65_536, 70_000, 200_000]), min_size=1, max_size=6),
    st.lists(st.integers(1, 150_000), min_size=1, max_size=6),
)
def test_large_and_small_frames_come_in_pieces_of_any_size(sizes: list[int], pieces: list[int]) -> None:
    bodies = [bytes([number]) * size for number, size in enumerate(sizes)]
    data = b"".join(local_wire.frame(FrameType.RESPONSE, body) for body in bodies)
    reader, received, at, turn = FrameReader(), [], 0, 0
    while at < len(data):
        piece = data[at : at + pieces[turn % len(pieces)]]
        received += feed(reader, piece)
        at, turn = at + len(piece), turn + 1
    assert [bytes(body) for _kind, body in received] == bodies


@given(st.builds(Message, names, st.binary(max_size=300), names, st.integers(0, 255), st.integers(0, 1 << 63)))
def test_a_message_comes_back(message: Message) -> None:
    ((kind, body),) = feed(FrameReader(), local_wire.encode_message(message))
    assert kind == FrameType.MESSAGE
    assert local_wire.decode_message(body) == message


def test_a_verdict_and_a_loss_come_back() -> None:
    ((_, body),) = feed(FrameReader(), local_wire.encode_verdict(Verdict(7, 1 << 40, "queue_full")))
    assert local_wire.decode_verdict(body) == Verdict(7, 1 << 40, "queue_full")
    ((_, body),) = feed(FrameReader(), local_wire.encode_lost(12))
    assert local_wire.decode_lost(body) == 12


@given(st.binary(max_size=120))
def test_garbage_is_a_protocol_error_and_nothing_else(data: bytes) -> None:
    try:
        for kind, body in feed(FrameReader(), data):
            if kind == FrameType.PUBLISH:
                local_wire.decode_publish(body)
        local_wire.decode_publish(memoryview(data))
    except LocalProtocolError:
        return


def test_overrides_change_only_what_they_name() -> None:
    policy = TopicPolicy(priority=4, lifetime_s=2.0)
    assert Overrides().apply(policy) == policy
    assert Overrides(priority=0).apply(policy) == TopicPolicy(priority=0, lifetime_s=2.0)
    assert Overrides(lifetime_s=float("inf")).apply(policy).lifetime_s is None


@pytest.fixture
def ends() -> Iterator[tuple[Connection, socket.socket]]:
    here, there = socket.socketpair()
    here.setblocking(False)
    there.setblocking(False)
    yield Connection(here), there
    here.close()
    there.close()


def read_all(connection: Connection, sock: socket.socket) -> list[tuple[int, memoryview]]:
    reader, frames = FrameReader(), []
    while True:
        connection.flush()
        try:
            frames.extend(feed(reader, sock.recv(1 << 20)))
        except BlockingIOError:
            return frames


def test_a_slow_subscriber_loses_the_oldest_and_is_told_how_many(ends: tuple[Connection, socket.socket]) -> None:
    connection, sock = ends
    count = 3 * MAX_WAITING_BYTES // 100_000
    for number in range(count):
        connection.send(local_wire.encode_message(Message("t", bytes(100_000), "a", 1, number)), may_lose=True)
        connection.flush()
    received = read_all(connection, sock)  # with the last of them comes how many are missing
    numbers = [local_wire.decode_message(body).received_ns for kind, body in received if kind == FrameType.MESSAGE]
    lost = sum(local_wire.decode_lost(body) for kind, body in received if kind == FrameType.LOST)
    assert numbers == sorted(numbers)
    assert numbers[-1] == count - 1
    assert lost > 0
    assert lost + len(numbers) == count


def test_an_application_that_writes_garbage_is_disconnected(ends: tuple[Connection, socket.socket]) -> None:
    connection, sock = ends
    sock.send(b"\xff" * 10)
    connection.read()
    assert connection.is_closed


def test_the_socket_is_private_and_a_dead_daemons_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "s"
    stale = socket.socket(socket.AF_UNIX)
    stale.bind(str(path))
    stale.close()
    server = LocalServer(str(path))
    assert path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(SocketInUse, match="another daemon"):
        LocalServer(str(path))
    server.close()
    assert not path.exists()
