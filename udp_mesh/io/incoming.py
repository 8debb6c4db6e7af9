"""Stored messages of other nodes: into the file, then confirmed to their sender and given to applications."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from udp_mesh import local_features, local_wire
from udp_mesh.core.envelope import DurableId, Envelope
from udp_mesh.core.events import MessageDelivered
from udp_mesh.core.inbox import Inbox, Kept
from udp_mesh.core.mesh import MeshCore
from udp_mesh.io import compression, store_rows
from udp_mesh.io.confirmations import Confirmations
from udp_mesh.io.outgoing import payload_of, what_is_lost
from udp_mesh.io.server import ALL_TOPICS, Connection
from udp_mesh.local_wire import Message

if TYPE_CHECKING:
    from udp_mesh.io.store import Outcome, Store


class Applications(Protocol):
    """Whoever is connected."""

    connections: list[Connection]


class Incoming:
    """Messages for this node's applications. ``problem`` is told what the file could not do."""

    def __init__(
        self,
        core: MeshCore,
        server: Applications,
        inbox: Inbox,
        thread: Store,
        problem: Callable[[Outcome], None],
    ) -> None:
        self.counters: Counter[str] = Counter()
        self._server = server
        self._inbox = inbox
        self._thread = thread
        self._problem = problem
        self._confirmations = Confirmations(core)
        self._reading: set[DurableId] = set()
        inbox.restore(thread.contents.floors, thread.contents.ids, thread.contents.kept)

    def received(self, event: MessageDelivered, envelope: Envelope, body: memoryview) -> None:
        """Take a stored message from another node."""
        durable_id = envelope.stored
        assert durable_id is not None  # the caller looked
        statements = []
        if self._inbox.settle_below(durable_id.store, envelope.floor):
            statements += store_rows.put_floor(durable_id.store, envelope.floor)
        if self._inbox.knows(durable_id):
            self.counters["stored_duplicates"] += 1
            if not self._inbox.is_committing(durable_id):
                self._confirmations.add(event.source, event.priority, durable_id)
            return
        if not self._inbox.has_room_for_id(durable_id.store):
            self.counters["stored_too_many"] += 1
            return
        payload = bytes(body)
        if envelope.original_bytes is not None:
            unpacked = compression.decompress(body, envelope.original_bytes)
            if unpacked is None:
                self.counters["bad_compression"] += 1  # not confirmed: it ends at its sender, by age
                return
            payload = unpacked
        kept = Kept(
            durable_id,
            event.source,
            event.topic,
            event.priority,
            len(payload),
            time.time_ns(),
            event.now + self._inbox.age_s,
            payload,
        )
        self._inbox.add(kept)
        statements.append(store_rows.put_incoming(kept, payload, age_s=self._inbox.age_s))
        self._thread.write(statements, lambda outcome: self._received(kept, outcome))

    def _received(self, kept: Kept, outcome: Outcome) -> None:
        if outcome.reason:
            self._problem(outcome)
            self._inbox.not_committed(kept)
            return
        self._confirmations.add(kept.source, kept.priority, kept.durable_id)
        self.counters["stored_received"] += 1
        frame: bytes | None = None
        for connection in self._server.connections:  # who listens to everything takes nothing away from the others
            if ALL_TOPICS in connection.topics and kept.topic not in connection.topics:
                frame = frame or local_wire.encode_message(_message(kept))
                connection.send(frame, may_lose=True)
        self._inbox.committed(kept)
        if not kept.pending:
            kept.payload = None

    def hand_on(self, *, now: float) -> None:
        """Give applications and senders what they wait for."""
        for connection in self._server.connections:
            self._give(connection)
        self._confirmations.send(now=now)

    def _give(self, connection: Connection) -> None:
        while (kept := self._inbox.next_for(connection.number)) is not None:
            if kept.payload is None:
                self._fetch_kept(kept)
                return
            connection.send(local_features.encode_stored_message(kept.durable_id, _message(kept)))
            self._inbox.give(connection.number, kept)

    def _fetch_kept(self, kept: Kept) -> None:
        if kept.durable_id in self._reading:
            return
        self._reading.add(kept.durable_id)

        def done(outcome: Outcome) -> None:
            self._reading.discard(kept.durable_id)
            payload = payload_of(outcome)
            if payload is None:
                self._problem(what_is_lost(outcome, f"a message on {kept.topic} from {kept.source}"))
                self._inbox.lost(kept)
            else:
                kept.payload = payload

        self._thread.read(store_rows.incoming_payload(kept.durable_id), done)


def _message(kept: Kept) -> Message:
    return Message(kept.topic, kept.payload or b"", kept.source, kept.priority, kept.received_ns)
