"""The daemon's loop over fakes: how long it sleeps, and what it sends before it does."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from typing import Any

import pytest

from wnet.core.events import Count, Drop
from wnet.core.members import Outgoing
from wnet.io import node as node_module
from wnet.io.node import Node


class FakeMesh:
    """Has ``waiting`` frames for member 0, and a timer at ``due``."""

    def __init__(self, waiting: int, due: float) -> None:
        self.waiting, self.due = waiting, due
        self.counts: dict[str, int] = {}

    def set_addresses(self, _addresses: Sequence[bytes], *, now: float) -> None:
        pass

    def handle_timer(self, *, now: float) -> None:
        pass

    def next_timer(self) -> float:
        return self.due

    def frames_to_send(self, *, now: float, room: Sequence[int]) -> list[Outgoing]:
        count = min(self.waiting, room[0])
        self.waiting -= count
        return [Outgoing(0, b"frame", None, 1)] * count

    def take_delivered(self) -> list[bytes]:
        return []

    def next_event(self) -> None:
        return None


class FakePort:
    """Takes ``left`` frames, and no more until ``frees``."""

    ifname = "mon0"

    def __init__(self, end: socket.socket, left: int, frees: float | None) -> None:
        self._end, self.left, self._frees = end, left, frees

    def fileno(self) -> int:
        return self._end.fileno()

    def room(self, *, now: float) -> int:
        return min(self.left, 2)

    def frees_at(self) -> float | None:
        return None if self.left else self._frees

    def transmit(self, _frame: bytes, _rate_bps: int | None, *, now: float) -> Count | Drop | None:
        self.left -= 1
        return None


class End:
    """The mesh interface, or the control socket."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self.asking: list[socket.socket] = []

    def fileno(self) -> int:
        return self._end.fileno()


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    a, b = socket.socketpair()
    with a, b:
        yield a, b


def sleeps(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[socket.socket, socket.socket], mesh: FakeMesh, port: FakePort
) -> float:
    """How long the loop sleeps at first, at 100 s of its clock, which stands still."""
    told: list[float] = []

    def select(_read: Any, _write: Any, _error: Any, timeout_s: float) -> tuple[list[int], list[int], list[int]]:
        told.append(timeout_s)
        node.stop()
        return [], [], []

    monkeypatch.setattr(node_module.select, "select", select)
    monkeypatch.setattr(node_module.time, "monotonic", lambda: 100.0)
    interface, control = End(ends[0]), End(ends[1])
    node = Node(mesh, [port], interface, "wnet0", control, None)  # type: ignore[arg-type,list-item]
    try:
        node.run()
    finally:
        node.wake_write.close()
        node.__dict__["_wake"].close()
    return told[0]


def test_it_sends_as_long_as_there_is_room(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[socket.socket, socket.socket]
) -> None:
    mesh = FakeMesh(waiting=7, due=100.5)
    assert sleeps(monkeypatch, ends, mesh, FakePort(ends[0], 100, None)) == pytest.approx(0.5)
    assert mesh.waiting == 0


def test_without_room_what_is_due_waits_instead_of_spinning(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[socket.socket, socket.socket]
) -> None:
    """Where time is virtual it passes only while everybody sleeps: a spinning daemon would stop it for good."""
    mesh = FakeMesh(waiting=7, due=99.0)
    assert 0.0 < sleeps(monkeypatch, ends, mesh, FakePort(ends[0], 3, 100.2)) <= 0.002
    assert mesh.waiting == 4


def test_a_radio_that_reports_nothing_ends_the_sleep(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[socket.socket, socket.socket]
) -> None:
    assert sleeps(monkeypatch, ends, FakeMesh(3, 105.0), FakePort(ends[0], 2, 100.2)) == pytest.approx(0.2)
