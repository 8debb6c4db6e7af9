"""Incoming fragments of one peer's epoch: whole messages, each exactly once, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

from udp_mesh.core.rangeset import RangeSet
from udp_mesh.core.wire import DataFragment

STALE_AFTER_S = 30.0
STALE_OFFLINE_AFTER_S = 600.0  # the sender keeps its half through an outage
_REMEMBERED_RANGES = 4096
_MAX_PURGED = 4096


@dataclass(slots=True)
class ReassemblyMemory:
    """What all peers' partial messages may hold, in bytes, and what they have reserved."""

    limit_bytes: int
    reserved_bytes: int = 0


@dataclass(slots=True)
class Partial:
    """A message of which fragments are missing. ``reserved_bytes`` is its size once complete, or a little more."""

    fragment_count: int
    priority: int
    reserved_bytes: int
    last_at_s: float
    flags: int = 0
    topic: str | None = None
    parts: dict[int, bytes] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class WholeMessage:
    """A message of which every fragment has arrived."""

    message_id: int
    topic: str
    priority: int
    payload: bytes
    flags: int = 0


class Verdict(Enum):
    """What became of a fragment that did not complete a message."""

    STORED = auto()
    DUPLICATE = auto()
    NO_MEMORY = auto()
    """Not taken: its packet must not be acknowledged."""
    PURGED = auto()
    """Not taken: earlier fragments of the message were purged, and its sender has to be told."""
    CONTRADICTION = auto()
    """Not taken: it disagrees with the message's other fragments."""


class Reassembler:
    """Partial messages from one epoch of a peer."""

    def __init__(self, memory: ReassemblyMemory) -> None:
        self._memory = memory
        self._partials: dict[int, Partial] = {}
        self._settled = RangeSet(max_ranges=_REMEMBERED_RANGES)
        self._purged: dict[int, None] = {}

    def __len__(self) -> int:
        """Partial messages held."""
        return len(self._partials)

    def would_take(self, fragment: DataFragment) -> Verdict:
        """Say what :meth:`take` would do, changing nothing; STORED if the fragment is welcome."""
        if fragment.message_id in self._settled:
            return Verdict.DUPLICATE
        if fragment.message_id in self._purged:
            return Verdict.PURGED
        if fragment.fragment_count == 1:
            return Verdict.STORED
        partial = self._partials.get(fragment.message_id)
        if partial is None:
            return Verdict.STORED if self._has_room(_reservation(fragment)) else Verdict.NO_MEMORY
        what = (fragment.fragment_count, fragment.priority, fragment.flags)
        if (partial.fragment_count, partial.priority, partial.flags) != what:
            return Verdict.CONTRADICTION
        return Verdict.DUPLICATE if fragment.fragment_index in partial.parts else Verdict.STORED

    def take(self, fragment: DataFragment, *, now: float) -> WholeMessage | Verdict:
        """Add a fragment; return the message if it is whole now."""
        verdict = self.would_take(fragment)
        if verdict is not Verdict.STORED:
            return verdict
        if fragment.fragment_count == 1:
            self._settled.add(fragment.message_id)
            return WholeMessage(
                fragment.message_id,
                fragment.topic or "",
                fragment.priority,
                bytes(fragment.payload),
                fragment.flags,
            )
        partial = self._partials.get(fragment.message_id)
        if partial is None:
            partial = Partial(fragment.fragment_count, fragment.priority, _reservation(fragment), now, fragment.flags)
            self._partials[fragment.message_id] = partial
            self._memory.reserved_bytes += partial.reserved_bytes
        partial.parts[fragment.fragment_index] = bytes(fragment.payload)
        partial.last_at_s = now
        if fragment.topic is not None:
            partial.topic = fragment.topic
        if len(partial.parts) < partial.fragment_count:
            return Verdict.STORED
        self._release(fragment.message_id)
        self._settled.add(fragment.message_id)
        payload = b"".join(partial.parts[index] for index in range(partial.fragment_count))
        return WholeMessage(fragment.message_id, partial.topic or "", partial.priority, payload, partial.flags)

    def settle_below(self, floor: int) -> list[tuple[int, Partial]]:
        """Forget every message below ``floor``, which its sender has settled; return the partial ones."""
        self._settled.raise_floor(floor)
        for message_id in [number for number in self._purged if number < floor]:
            del self._purged[message_id]
        return [(number, self._release(number)) for number in [n for n in self._partials if n < floor]]

    def purge_stale(self, *, now: float, is_online: bool) -> list[tuple[int, Partial]]:
        """Forget partial messages without news for too long; return them. Their sender will be told when it goes on."""
        patience_s = STALE_AFTER_S if is_online else STALE_OFFLINE_AFTER_S
        stale = [number for number, p in self._partials.items() if now - p.last_at_s >= patience_s]
        for number in stale:
            self._purged[number] = None
            if len(self._purged) > _MAX_PURGED:
                del self._purged[next(iter(self._purged))]
        return [(number, self._release(number)) for number in stale]

    def touch(self, *, now: float) -> None:
        """Start the time of every partial afresh: an outage is no reason to purge."""
        for partial in self._partials.values():
            partial.last_at_s = now

    def clear(self) -> list[tuple[int, Partial]]:
        """Forget everything: the sender was restarted. Return the partial messages."""
        return [(number, self._release(number)) for number in list(self._partials)]

    def _has_room(self, size_bytes: int) -> bool:
        return self._memory.reserved_bytes + size_bytes <= self._memory.limit_bytes

    def _release(self, message_id: int) -> Partial:
        partial = self._partials.pop(message_id)
        self._memory.reserved_bytes -= partial.reserved_bytes
        return partial


def _reservation(fragment: DataFragment) -> int:
    """Return about the size of the whole message; the last fragment may be short, so allow for a usual one."""
    is_last = fragment.fragment_index == fragment.fragment_count - 1
    return fragment.fragment_count * max(len(fragment.payload), 1400 if is_last else 0)
