"""Publishing stored messages: first into the file, then to the transport, as far as it should hold them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from udp_mesh import local_wire
from udp_mesh.core import envelope as envelopes
from udp_mesh.core import wire
from udp_mesh.core.custody import Custody
from udp_mesh.core.envelope import DurableId, Envelope
from udp_mesh.core.events import RefusalReason
from udp_mesh.core.mesh import MeshCore, Refused
from udp_mesh.core.settings import BROADCAST_NAME, MAX_MESSAGE_BYTES, Keep, Offline, Reliability, TopicPolicy
from udp_mesh.core.stored import Stored
from udp_mesh.io import compression, store_rows
from udp_mesh.io.fates import Fates
from udp_mesh.io.server import Connection
from udp_mesh.local_wire import Publish, Verdict

if TYPE_CHECKING:
    from udp_mesh.io.store import Outcome, Store

SEEK_INTERVAL_S = 60.0
MAX_COMMITTING_BYTES = 4 * 1024 * 1024
_MIN_LIFETIME_S = 0.001


class Outgoing:
    """Messages of this node. ``problem`` is told what the file could not do."""

    def __init__(
        self,
        core: MeshCore,
        custody: Custody,
        thread: Store,
        problem: Callable[[Outcome], None],
        clock: Callable[[], float],
        fates: Fates,
    ) -> None:
        self.counters: Counter[str] = Counter()
        self.known_peers = dict.fromkeys(thread.contents.peers)
        self.store_id = thread.contents.store_id
        self.seek_at_s = 0.0
        self._core = core
        self._custody = custody
        self._thread = thread
        self._problem = problem
        self._clock = clock
        self._fates = fates
        self._requests = thread.contents.requests
        self._deciding: dict[tuple[int, int], list[tuple[Connection, int]]] = {}
        self._committing_bytes = 0
        self._reading: set[int] = set()
        custody.next_sequence = thread.contents.next_sequence
        custody.restore(thread.contents.outgoing)

    def remember(self, peer: str) -> None:
        """Take messages for a node of this name from now on, also when it has not been heard since a restart."""
        if peer not in self.known_peers:
            self.known_peers[peer] = None
            self._thread.write([store_rows.put_peer(peer)], ignore)

    def has_room(self) -> bool:
        """Whether the file keeps up with what is published."""
        return self._committing_bytes < MAX_COMMITTING_BYTES

    def publish(self, connection: Connection, publish: Publish, policy: TopicPolicy) -> None:
        """Store a message and answer once it is safe; an application that repeats a publish gets the same answer."""
        key = (connection.client, publish.request)
        if key in self._deciding:
            self._deciding[key].append((connection, publish.request))
            return
        sequence = self._requests.get(connection.client, {}).get(publish.request)
        if connection.client and sequence is not None:
            if publish.is_tracked:
                peer = None if publish.to == BROADCAST_NAME else publish.to
                self._fates.resume(connection, publish.request, sequence, peer, self._custody)
            answer([(connection, publish.request)], sequence, None)
            return
        packed = compression.compress(publish.payload) if policy.compress else None
        payload = packed or bytes(publish.payload)
        try:
            entries = self._admit(publish, payload, packed, policy)
        except Refused as refusal:
            self.counters[f"refused_{refusal.reason.value}"] += 1
            answer([(connection, publish.request)], 0, refusal.reason)
            return
        self._deciding[key] = [(connection, publish.request)]
        tracked = [(entry.sequence, entry.peer) for entry in entries] if publish.is_tracked else []
        self._fates.admit(connection, publish.request, tracked)
        self._commit(key, entries, payload, tracked)

    def _admit(self, publish: Publish, payload: bytes, packed: bytes | None, policy: TopicPolicy) -> list[Stored]:
        if not 0 < len(publish.topic.encode()) <= min(wire.MAX_TOPIC_BYTES, self._core.settings.packet_bytes // 2):
            raise Refused(RefusalReason.BAD_TOPIC)
        if not 0 <= policy.priority <= 255 or (policy.lifetime_s is not None and policy.lifetime_s <= 0):
            raise Refused(RefusalReason.BAD_POLICY)
        limit_bytes = min(MAX_MESSAGE_BYTES, self._core.settings.queue_bytes) - envelopes.MAX_ENVELOPE_BYTES
        if len(payload) > limit_bytes:
            raise Refused(RefusalReason.TOO_LARGE)
        return self._custody.admit(
            publish.topic,
            len(payload),
            self._destinations(publish.to),
            replace(policy, reliability=Reliability.RELIABLE),
            payload=payload,
            original_bytes=None if payload is not packed else len(publish.payload),
            now=self._clock(),
        )

    def _destinations(self, to: str) -> list[str]:
        if to == self._core.settings.name:
            raise Refused(RefusalReason.OWN_NAME)
        known = list(self.known_peers)
        if to != BROADCAST_NAME and to not in self.known_peers:
            raise Refused(RefusalReason.UNKNOWN_PEER)
        if not known:
            raise Refused(RefusalReason.PEER_OFFLINE)
        return known if to == BROADCAST_NAME else [to]

    def _commit(
        self, key: tuple[int, int], entries: list[Stored], payload: bytes, tracked: list[tuple[int, str]]
    ) -> None:
        client, request = key
        sequence = entries[0].sequence
        statements = [store_rows.put_outgoing(entry, payload) for entry in entries]
        taken = self._requests.setdefault(client, {})
        if client:
            taken[request] = sequence
            statements.append(store_rows.put_taken(client, request, sequence))
            if len(taken) > store_rows.REMEMBERED_REQUESTS:
                oldest = next(iter(taken))
                del taken[oldest]
                statements.append(store_rows.drop_taken(client, oldest))
        self._committing_bytes += len(payload) + 1

        def done(outcome: Outcome) -> None:
            now = self._clock()
            self._committing_bytes -= len(payload) + 1
            for entry in entries:
                if outcome.reason:
                    self._custody.not_committed(entry)
                else:
                    self._custody.committed(entry, now=now)
                    if not self._core.is_online(entry.peer):
                        entry.payload = None  # the file has it
            askers = self._deciding.pop(key)
            if outcome.reason:
                taken.pop(request, None)
                self._problem(outcome)
                self._fates.forget(tracked)
            elif tracked:
                self._fates.committed(askers, tracked)
            reason = RefusalReason(outcome.reason) if outcome.reason else None
            answer(askers, 0 if reason else sequence, reason)

        self._thread.write(statements, done)

    def feed(self, *, now: float) -> None:
        """Take back from the transport what the store has dropped; give it what is due, where the peer is online."""
        withdrawn, self._custody.withdrawn = self._custody.withdrawn, []
        for dropped, reason in withdrawn:
            self._core.withdraw(dropped.peer, dropped.sequence, reason, now=now)
        seeks = now >= self.seek_at_s
        if seeks:
            self.seek_at_s = now + SEEK_INTERVAL_S
        for peer in self._custody.destinations():
            if not self._core.is_online(peer):
                if seeks:
                    self._core.seek(peer, now=now)
                continue
            while (entry := self._custody.next_to_feed(peer, now=now)) is not None:
                if entry.payload is None:
                    self._fetch(entry)
                    break
                self._hand_over(entry, entry.payload, now=now)

    def _hand_over(self, entry: Stored, payload: bytes, *, now: float) -> None:
        envelope = Envelope(
            stored=DurableId(self.store_id, entry.sequence),
            floor=self._custody.floor(entry.peer),
            original_bytes=entry.original_bytes,
        )
        lifetime_s = max(entry.deadline_s - now, _MIN_LIFETIME_S)
        policy = replace(entry.policy, keep=Keep.ALL, offline=Offline.DISCARD, lifetime_s=lifetime_s)
        self._custody.fed(entry)
        try:
            self._core.publish(
                entry.topic,
                envelopes.encode(envelope) + payload,
                to=entry.peer,
                policy=policy,
                flags=wire.DATA_FLAG_ENVELOPE,
                token=entry.sequence,
                now=now,
            )
        except Refused:
            self._custody.refused(entry, now=now)
        else:
            entry.payload = None  # the transport has it, and so has the file

    def _fetch(self, entry: Stored) -> None:
        if entry.sequence in self._reading:
            return
        self._reading.add(entry.sequence)

        def done(outcome: Outcome) -> None:
            self._reading.discard(entry.sequence)
            payload = payload_of(outcome)
            if payload is not None and not entry.is_done:
                entry.payload = payload
            elif payload is None:
                self._problem(what_is_lost(outcome, f"message {entry.sequence} to {entry.peer}"))
                self._custody.lost(entry, now=self._clock())

        self._thread.read(store_rows.outgoing_payload(entry.sequence), done)


def answer(askers: list[tuple[Connection, int]], sequence: int, reason: RefusalReason | None) -> None:
    """Tell applications what became of their publishes."""
    for connection, request in askers:
        if not connection.is_closed:
            verdict = Verdict(request, sequence, reason.value if reason else "")
            connection.send(local_wire.encode_verdict(verdict))


def payload_of(outcome: Outcome) -> bytes | None:
    """Return the payload that a query found, None if the file no longer has it as it was."""
    payload, crc = outcome.rows[0] if outcome.rows else (None, None)
    return payload if isinstance(payload, bytes) and store_rows.is_sound(payload, crc) else None


def what_is_lost(outcome: Outcome, message: str) -> Outcome:
    """Return what to report when a query did not find the payload of a message."""
    from udp_mesh.io.store import Outcome  # SQLite is paid for by those who have a store

    return outcome if outcome.reason else Outcome("store_corrupted", f"the payload of {message} is damaged or gone")


def ignore(_outcome: Outcome) -> None:
    """What could not be removed is found again at the next start, and known to the other side."""
