"""A daemon that stores, and its application: everything real but the clock, the disk's delay and the network, that is
core, custody, inbox, SQLite file and the client's state."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

from udp_mesh import local_fates, local_features, local_wire
from udp_mesh.client_fates import TrackedMessage
from udp_mesh.client_state import ClientState
from udp_mesh.client_types import PublishOptions, overrides_of
from udp_mesh.config import Config
from udp_mesh.core import envelope as envelopes
from udp_mesh.core import wire
from udp_mesh.core.events import Event, MessageDelivered
from udp_mesh.core.settings import Offline
from udp_mesh.frame_reader import FrameReader
from udp_mesh.io import store_file
from udp_mesh.io.durable import Durable
from udp_mesh.io.store import Done, Outcome
from udp_mesh.io.store_rows import Statement

TURN_S = 0.004


def feed(state: ClientState, data: bytes) -> None:
    """Give a client bytes of its daemon."""
    while data:
        buffer = state.buffer()
        size = min(len(buffer), len(data))
        buffer[:size] = data[:size]
        state.filled(size)
        data = data[size:]


def frames_of(data: bytes) -> list[tuple[int, memoryview]]:
    """Cut what a client sends into frames."""
    reader, frames = FrameReader(), []
    while data:
        buffer = reader.buffer()
        size = min(len(buffer), len(data))
        buffer[:size] = data[:size]
        frames += reader.filled(size)
        data = data[size:]
    return frames


class SlowDisk:
    """A real file; what is written takes effect and is reported some milliseconds later, unless a kill comes first."""

    def __init__(self, path: str, age_s: float, now: float, *, net: Any) -> None:
        self._net = net
        self._database = store_file.connect(path)
        self._database.execute("PRAGMA synchronous=OFF")  # the tests' own disk need not survive a power cut
        self.contents = store_file.read(self._database, age_s=age_s, now=now)
        self.notes: list[str] = []
        self.is_full = False
        self._jobs: list[tuple[float, list[Statement], Statement | None, Done]] = []

    def fileno(self) -> int:
        return -1

    def write(self, statements: list[Statement], done: Done) -> None:
        self._jobs.append((self._due_s(), statements, None, done))

    def read(self, query: Statement, done: Done) -> None:
        self._jobs.append((self._due_s(), [], query, done))

    def _due_s(self) -> float:
        last_s = self._jobs[-1][0] if self._jobs else 0.0
        return max(last_s, self._net.now + self._net.rng.uniform(0.0, 0.03))

    def outcomes(self) -> Iterator[tuple[Done, Outcome]]:
        while self._jobs and self._jobs[0][0] <= self._net.now:
            _due_s, statements, query, done = self._jobs.pop(0)
            if self.is_full and statements:
                yield done, Outcome("disk_full", "as the test wants it")
                continue
            self._database.execute("BEGIN")
            for statement in statements:
                self._database.execute(*statement)
            rows = self._database.execute(*query).fetchall() if query else None
            self._database.execute("COMMIT")
            yield done, Outcome(rows=rows)

    def commit_some(self, count: int) -> None:
        """A kill after the commit and before its outcome is heard."""
        for _due_s, statements, _query, _done in self._jobs[:count]:
            for statement in statements:
                self._database.execute(*statement)

    def count(self, table: str) -> int:
        (count,) = self._database.execute(f"SELECT COUNT(*) FROM {table}").fetchone()
        return int(count)

    def close(self) -> None:
        self._database.close()


class Wire:
    """A daemon's end of one application's connection."""

    def __init__(self, number: int, state: ClientState) -> None:
        self.number, self.client, self.state = number, state.client, state
        self.topics: set[str] = set()
        self.is_closed = False
        self.lost = False

    def send(self, frame: bytes, *, may_lose: bool = False) -> None:
        if not self.lost:
            feed(self.state, frame)


class Station:
    """A node whose daemon can be killed; its application lives on."""

    def __init__(self, net: Any, name: str, folder: Path, topics: tuple[str, ...] = ()) -> None:
        self.net, self.name = net, name
        self.config = Config(name=name, store=str(folder / f"{name}.db"))
        self.state = ClientState()
        self.topics = topics
        self.received: list[bytes] = []
        self.durable: Durable | None = None
        self.connections: list[Any] = []
        self.number = 0
        self.reported: list[Event] = []
        self._seen_events = 0
        net.events.setdefault(name, [])

    def start(self) -> None:
        core = self.net.add(self.name)
        self.connections.clear()
        self.durable = Durable(
            core,
            self,  # type: ignore[arg-type]
            self.config,
            self._report,
            clock=lambda: self.net.now,
            open_store=lambda path, age_s, now: SlowDisk(path, age_s, now, net=self.net),
        )
        self._seen_events = len(self.net.events[self.name])
        assert self.durable._open() is not None
        self._connect()

    def _report(self, event: Event) -> None:
        self.reported.append(event)
        if self.durable is not None:
            self.durable.fates.on_event(event)

    def _connect(self) -> None:
        assert self.durable is not None
        self.number += 1
        connection = Wire(self.number, self.state)
        self.connections.append(connection)
        for kind, body in frames_of(self.state.connected()):
            self._frame(connection, kind, body)
        for topic in self.topics:
            connection.topics.add(topic)
            self.durable.inbox.subscribe(connection.number, topic)

    def kill(self, rng: Random) -> None:
        assert self.durable is not None
        disk = self.durable._thread
        assert isinstance(disk, SlowDisk)
        disk.commit_some(rng.randrange(0, 4))
        disk.close()
        self.net.stop(self.name)
        self.durable = None
        self.connections.clear()
        self.state.disconnected()

    def publish(self, topic: str, payload: bytes, to: str, **options: Any) -> TrackedMessage:
        """As the blocking client does; return what becomes of it."""
        chosen, tracked = PublishOptions(offline="store", **options), TrackedMessage(to)
        _request, frame = self.state.encode_publish(topic, payload, to, overrides_of(chosen), tracked=tracked)
        if self.connections:
            ((kind, body),) = frames_of(frame)
            self._frame(self.connections[0], kind, body)
        return tracked

    def _frame(self, connection: Any, kind: int, body: memoryview) -> None:
        assert self.durable is not None
        if kind == local_wire.FrameType.PUBLISH:
            publish = local_wire.decode_publish(body)
            policy = publish.overrides.apply(self.durable._core.settings.policy(publish.topic))
            assert policy.offline is Offline.STORE
            self.durable.publish(connection, publish, policy)
        elif kind == local_wire.FrameType.FOLLOW:
            request, sequence, peer = local_fates.decode_follow(body)
            self.durable.fates.follow(connection, request, sequence, peer, self.durable.custody)
        elif kind == local_wire.FrameType.TAKEN:
            for durable_id in local_features.decode_taken(body):
                self.durable.inbox.take(connection.number, durable_id)

    def turn(self) -> None:
        if self.durable is None:
            return
        self.durable.completed()
        events = self.net.events[self.name]
        for event in events[self._seen_events :]:
            self.durable.on_event(event)
            if isinstance(event, MessageDelivered) and event.flags & wire.DATA_FLAG_ENVELOPE:
                decoded = envelopes.decode(event.payload)
                assert decoded is not None
                envelope, body = decoded
                if envelope.confirms:
                    self.durable.confirmed(event.source, body, now=event.now)
                else:
                    self.durable.received(event, envelope, body)
        self._seen_events = len(events)
        self.durable.turn(now=self.net.now)
        self._read()

    def _read(self) -> None:
        while (message := self.state.next_message()) is not None:
            self.received.append(message.payload)
        taken = self.state.stored.taken_frame()
        if taken and self.connections and self.net.rng.random() < 0.5:  # sometimes the kill comes before the answer
            ((kind, body),) = frames_of(taken)
            self._frame(self.connections[0], kind, body)
            self.state.stored.told_taken()
