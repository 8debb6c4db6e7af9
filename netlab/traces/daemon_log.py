"""What the daemons told of their messages: queued, held back, let go, ended, delivered; whom they met in which epoch.

Values, and the collector that makes them of events in the order of time. Knows nothing of files and packets.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

ACKED = "acked"
CONFIRMED = "confirmed"
SENDER_RESTARTED = "sender_restarted"
_COPY_WITHIN_NS = 1_000_000_000  # between a daemon's event and its packet; a restarted daemon begins its numbers anew


@dataclass(slots=True)
class StoredMessage:
    """One message that a node's store has had safe for one destination.

    ``outcome``: ``confirmed``, a reason to drop it, or None while it waits. ``was_queued``: the transport was given it.
    """

    stored_ns: int
    sequence: int
    ended_ns: int | None = None
    outcome: str | None = None
    was_queued: bool = False


@dataclass(slots=True)
class QueuedMessage:
    """One message in the queue of one node for one destination, ``all`` for a broadcast.

    Attributes:
        message_id: As the publisher was told; ``wire_ids`` has those that followed when it was begun anew, with times.
        stored: In the node's store, from before the transport was given it; None for a message of no store.
        held: Whether the topic's rate limit kept it back.
        released_ns: When the rate limit let it go; None if it never held it, or holds it still.
        ended_ns: When it was acknowledged or dropped; None while it waits, and for broadcasts, whose end nobody tells.
        outcome: ``acked``, a reason to drop it, or ``sender_restarted``.
    """

    node: str
    peer: str
    message_id: int
    topic: str
    priority: int
    size_bytes: int
    fragment_count: int
    queued_ns: int
    stored: StoredMessage | None = None
    held: bool = False
    released_ns: int | None = None
    ended_ns: int | None = None
    outcome: str | None = None
    may_have_arrived: bool = False
    wire_ids: list[tuple[int, int]] = field(default_factory=list)

    @property
    def ids_on_wire(self) -> set[int]:
        """All the ids with which its fragments may have left."""
        return {self.message_id, *(wire_id for _, wire_id in self.wire_ids)}

    @property
    def last_id_on_wire(self) -> int:
        """The id with which it arrived, if it did."""
        return self.wire_ids[-1][1] if self.wire_ids else self.message_id

    def is_held(self, t_ns: int) -> bool:
        """Whether the rate limit kept it back at that time."""
        return self.held and self.queued_ns <= t_ns and (self.released_ns is None or self.released_ns > t_ns)


@dataclass(frozen=True, slots=True)
class Meeting:
    """A node found a peer online (``is_up``), or held it offline from then on."""

    t_ns: int
    is_up: bool
    epoch: int
    reason: str


@dataclass(frozen=True, slots=True)
class Dropped:
    """A message that a node gave up, or a stored one (``is_stored``), or what it had received of one (``is_partial``).

    ``peer`` is the destination; for what had been received, the source.
    """

    t_ns: int
    node: str
    peer: str
    topic: str
    priority: int | None
    size_bytes: int
    reason: str
    is_stored: bool = False
    is_partial: bool = False


@dataclass(slots=True)
class DaemonLog:
    """All of it. ``queued`` is by node, in the order of time; ``delivered`` by receiver, source and id on the wire;
    ``copied``: when a fragment left once more for ``redundancy``, by node, peer, packet number, wire id and index.
    """

    queued: dict[str, list[QueuedMessage]] = field(default_factory=lambda: defaultdict(list))
    delivered: dict[tuple[str, str, int], list[int]] = field(default_factory=lambda: defaultdict(list))
    meetings: dict[tuple[str, str], list[Meeting]] = field(default_factory=lambda: defaultdict(list))
    drops: list[Dropped] = field(default_factory=list)
    copied: dict[tuple[str, str, int, int, int], list[int]] = field(default_factory=lambda: defaultdict(list))
    stored: dict[tuple[str, str, str], list[StoredMessage]] = field(default_factory=lambda: defaultdict(list))
    """By node, peer and topic, in order."""
    events_lost: int = 0
    _open: dict[tuple[str, str, int], QueuedMessage] = field(default_factory=dict)

    def take(self, t_ns: int, node: str, event: Mapping[str, object]) -> None:
        """Take one event of a node's daemon; those that tell nothing of this are ignored."""
        match event.get("event"):
            case "message_queued":
                self._queue(t_ns, node, event)
            case "message_held" | "message_released" | "message_acked" | "message_dropped" | "message_begun_anew":
                self._change(t_ns, node, event)
            case "message_delivered":
                key = (node, _text(event, "source"), _number(event, "message_id"))
                self.delivered[key].append(t_ns)
            case "peer_up" | "peer_down" as change:
                meeting = Meeting(t_ns, change == "peer_up", _number(event, "epoch"), _text(event, "reason"))
                self.meetings[node, _text(event, "peer")].append(meeting)
            case "fragment_copied":
                number, index = _number(event, "packet_number"), _number(event, "fragment_index")
                self.copied[node, _text(event, "peer"), number, _number(event, "message_id"), index].append(t_ns)
            case "message_stored":
                kept = StoredMessage(t_ns, _number(event, "sequence"))
                self.stored[node, _text(event, "peer"), _text(event, "topic")].append(kept)
            case "message_confirmed" | "stored_dropped" as end:
                self._end_stored(t_ns, node, event)
                if end == "stored_dropped":
                    self._drop(t_ns, node, event, is_stored=True)
            case "partial_purged" if event.get("is_settled") is not True:
                peer, topic = _text(event, "source"), ""
                self.drops.append(Dropped(t_ns, node, peer, topic, None, 0, "partial_purged", is_partial=True))
            case "events_lost":
                self.events_lost += _number(event, "count")

    def restart(self, t_ns: int, node: str) -> None:
        """A node's daemon was killed: what it had queued is gone."""
        for key, message in list(self._open.items()):
            if key[0] == node:
                message.ended_ns, message.outcome = t_ns, SENDER_RESTARTED
                del self._open[key]

    def epochs(self) -> dict[int, str]:
        """Every epoch that was met, and whose it was."""
        return {meeting.epoch: peer for (_, peer), all_ in self.meetings.items() for meeting in all_ if meeting.epoch}

    def delivered_at(self, receiver: str, source: str, wire_id: int, *, from_ns: int) -> int | None:
        """When a receiver's daemon had a whole message, at or after a time; None if it never said so."""
        times = self.delivered.get((receiver, source, wire_id), [])
        index = bisect_right(times, from_ns - 1)
        return times[index] if index < len(times) else None

    def is_copy(self, key: tuple[str, str, int, int, int], t_ns: int) -> bool:
        """Whether a fragment that left at ``t_ns`` was such a copy; ``key`` as of :attr:`copied`."""
        told = self.copied.get(key)
        return told is not None and any(abs(t_ns - told_ns) < _COPY_WITHIN_NS for told_ns in told)

    def topic_of(self, node: str, wire_id: int, t_ns: int) -> str:
        """The topic of a message of which a fragment left at that time; empty if its daemon never told."""
        queued = self.queued.get(node, [])
        index = bisect_right(queued, t_ns, key=lambda message: message.queued_ns)
        return next((m.topic for m in reversed(queued[:index]) if wire_id in m.ids_on_wire), "")

    def waiting(self, node: str, t_ns: int) -> Iterator[QueuedMessage]:
        """The messages for peers that a node had in its queue at a time; broadcasts cannot be told from events."""
        for message in self.queued.get(node, []):
            if message.queued_ns > t_ns:
                return
            if message.peer != "all" and (message.ended_ns is None or message.ended_ns > t_ns):
                yield message

    def _queue(self, t_ns: int, node: str, event: Mapping[str, object]) -> None:
        peer, message_id, topic = _text(event, "peer"), _number(event, "message_id"), _text(event, "topic")
        priority, size_bytes = _number(event, "priority"), _number(event, "size_bytes")
        message = QueuedMessage(
            node, peer, message_id, topic, priority, size_bytes, _number(event, "fragment_count"), t_ns
        )
        kept = self.stored.get((node, peer, topic), [])
        message.stored = next((entry for entry in kept if not entry.was_queued and entry.ended_ns is None), None)
        if message.stored is not None:
            message.stored.was_queued = True
        forgotten = self._open.get((node, peer, message_id))
        if forgotten is not None:  # ids begin anew after a start
            self.restart(t_ns, node)
        self.queued[node].append(message)
        if peer != "all":
            self._open[node, peer, message_id] = message

    def _change(self, t_ns: int, node: str, event: Mapping[str, object]) -> None:
        key = (node, _text(event, "peer"), _number(event, "message_id"))
        message = self._open.get(key)
        if event["event"] == "message_dropped":
            self._drop(t_ns, node, event)
        if message is None:
            return
        match event["event"]:
            case "message_held":
                message.held = True
            case "message_released":
                message.released_ns = t_ns
            case "message_begun_anew":
                message.wire_ids.append((t_ns, _number(event, "wire_id")))
            case "message_acked":
                message.ended_ns, message.outcome = t_ns, ACKED
                del self._open[key]
            case "message_dropped":
                message.ended_ns, message.outcome = t_ns, _text(event, "reason")
                message.may_have_arrived = event.get("may_have_arrived") is True
                del self._open[key]

    def _end_stored(self, t_ns: int, node: str, event: Mapping[str, object]) -> None:
        sequence, reason = _number(event, "sequence"), _text(event, "reason") or CONFIRMED
        for entry in self.stored.get((node, _text(event, "peer"), _text(event, "topic")), []):
            if entry.sequence == sequence:
                entry.ended_ns, entry.outcome = t_ns, reason

    def _drop(self, t_ns: int, node: str, event: Mapping[str, object], *, is_stored: bool = False) -> None:
        peer, topic, reason = _text(event, "peer"), _text(event, "topic"), _text(event, "reason")
        priority, size_bytes = _number(event, "priority"), _number(event, "size_bytes")
        self.drops.append(Dropped(t_ns, node, peer, topic, priority, size_bytes, reason, is_stored))


def _text(event: Mapping[str, object], key: str) -> str:
    value = event.get(key)
    return "" if value is None else str(value)


def _number(event: Mapping[str, object], key: str) -> int:
    value = event.get(key)
    return int(value) if isinstance(value, int | float) else 0
