"""Incoming fragments of one peer's epoch: whole messages, each exactly once, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

from udp_mesh.core.rangeset import RangeSet
from udp_mesh.core.wire import DataFragment, first_fragment_overhead_bytes
from udp_mesh.core.wire_runs import Run

STALE_AFTER_S = 30.0
STALE_OFFLINE_AFTER_S = 600.0  # the sender keeps its half through an outage
_REMEMBERED_RANGES = 4096
_MAX_PURGED = 4096


@dataclass(slots=True)
class ReassemblyMemory:
    """What all peers' partial messages may hold, in bytes, and what they have reserved."""

    limit_bytes: int
    reserved_bytes: int = 0


class About(NamedTuple):
    """What every fragment of a message says of it."""

    fragment_count: int
    priority: int
    flags: int


class Partial:
    """A message of which fragments are missing.

    All fragments but the last have one length, ``stride``, if the topic counts as a part of fragment 0: so each has its
    place in one buffer, which begins with room for the topic. ``stride`` is 0 until one of them has arrived.
    """

    __slots__ = (
        "_buffer",
        "_have",
        "_head_bytes",
        "_last",
        "about",
        "last_at_s",
        "received_count",
        "reserved_bytes",
        "stride",
        "topic",
    )

    def __init__(self, about: About) -> None:
        self.about = about
        self.reserved_bytes = 0
        self.last_at_s = 0.0
        self.topic: str | None = None
        self.received_count = 0
        self.stride = 0
        self._buffer = memoryview(b"")
        self._have = bytearray(about.fragment_count)
        self._head_bytes = 0
        self._last = b""

    @property
    def fragment_count(self) -> int:
        """Fragments of the whole message."""
        return self.about.fragment_count

    def has_any(self, index: int, count: int = 1) -> bool:
        """Whether at least one of these fragments is there."""
        return self._have.count(1, index, index + count) > 0

    def fits(self, about: About, length: int, *, is_last: bool = False) -> bool:
        """Whether fragments of this length, the topic included, agree with the others."""
        if about != self.about:
            return False
        if is_last:
            return not self.stride or length <= self.stride
        return length == self.stride if self.stride else length >= len(self._last)

    def take(self, fragment: DataFragment) -> None:
        """Add a fragment that fits and is not there."""
        index = fragment.fragment_index
        if index < self.fragment_count - 1:
            self.take_run(index, [fragment.payload], fragment.topic, _stride_of(fragment) - len(fragment.payload))
            return
        self._last = bytes(fragment.payload)
        self._have[index] = 1
        self.received_count += 1

    def take_run(self, index: int, payloads: list[memoryview], topic: str | None, topic_bytes: int) -> None:
        """Add consecutive fragments that fit and are not there, the last of the message not among them."""
        if not self.stride:
            self.stride = len(payloads[0]) + topic_bytes
            self._buffer = memoryview(bytearray(self.stride * (self.fragment_count - 1)))
        if topic is not None:
            self.topic, self._head_bytes = topic, topic_bytes
        buffer, start = self._buffer, index * self.stride + topic_bytes
        for payload in payloads:
            end = start + len(payload)
            buffer[start:end] = payload
            start = end
        count = len(payloads)
        self._have[index : index + count] = b"\1" * count
        self.received_count += count

    def payload(self) -> bytes:
        """Return the whole message."""
        return b"".join((self._buffer[self._head_bytes :], self._last))


@dataclass(frozen=True, slots=True)
class WholeMessage:
    """A message of which every fragment has arrived."""

    message_id: int
    topic: str
    about: About
    payload: bytes


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
        partial = self._partials.get(fragment.message_id)
        if partial is None:
            if fragment.message_id in self._settled:
                return Verdict.DUPLICATE
            if fragment.message_id in self._purged:
                return Verdict.PURGED
            if fragment.fragment_count == 1:
                return Verdict.STORED
        elif not partial.fits(_about(fragment), _stride_of(fragment), is_last=_is_last(fragment)):
            return Verdict.CONTRADICTION
        elif partial.has_any(fragment.fragment_index):
            return Verdict.DUPLICATE
        return Verdict.STORED if self._has_room(partial, _reservation(fragment)) else Verdict.NO_MEMORY

    def take(self, fragment: DataFragment, *, now: float) -> WholeMessage | Verdict:
        """Add a fragment; return the message if it is whole now."""
        verdict = self.would_take(fragment)
        if verdict is not Verdict.STORED:
            return verdict
        message_id, count = fragment.message_id, fragment.fragment_count
        if count == 1:
            self._settled.add(message_id)
            return WholeMessage(message_id, fragment.topic or "", _about(fragment), bytes(fragment.payload))
        partial = self._partial(message_id, _about(fragment), _reservation(fragment), now=now)
        partial.take(fragment)
        return self._whole(message_id, partial) or Verdict.STORED

    def take_run(self, run: Run, *, now: float) -> WholeMessage | Verdict | None:
        """Add a run of fragments, as :meth:`take`; None, and nothing is changed, unless all of them are new and fit."""
        about = About(run.fragment_count, run.priority, run.flags)
        length = run.topic_bytes + len(run.payloads[0])
        partial = self._partials.get(run.message_id)
        if partial is None:
            if run.message_id in self._settled or run.message_id in self._purged:
                return None
        elif not partial.fits(about, length) or partial.has_any(run.fragment_index, len(run.payloads)):
            return None
        if not self._has_room(partial, about.fragment_count * length):
            return None
        partial = self._partial(run.message_id, about, about.fragment_count * length, now=now)
        partial.take_run(run.fragment_index, run.payloads, run.topic, run.topic_bytes)
        return self._whole(run.message_id, partial) or Verdict.STORED

    def _whole(self, message_id: int, partial: Partial) -> WholeMessage | None:
        """Return the message if all of it is there, and settle it."""
        if partial.received_count < partial.fragment_count:
            return None
        self._release(message_id)
        self._settled.add(message_id)
        return WholeMessage(message_id, partial.topic or "", partial.about, partial.payload())

    def _partial(self, message_id: int, about: About, reserved_bytes: int, *, now: float) -> Partial:
        """Return the partial message, made if need be, with at least this much memory reserved."""
        partial = self._partials.get(message_id)
        if partial is None:
            partial = self._partials[message_id] = Partial(about)
        self._memory.reserved_bytes += max(0, reserved_bytes - partial.reserved_bytes)
        partial.reserved_bytes = max(reserved_bytes, partial.reserved_bytes)
        partial.last_at_s = now
        return partial

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

    def _has_room(self, partial: Partial | None, size_bytes: int) -> bool:
        more_bytes = size_bytes - (0 if partial is None else partial.reserved_bytes)
        return more_bytes <= 0 or self._memory.reserved_bytes + more_bytes <= self._memory.limit_bytes

    def _release(self, message_id: int) -> Partial:
        partial = self._partials.pop(message_id)
        self._memory.reserved_bytes -= partial.reserved_bytes
        return partial


def _stride_of(fragment: DataFragment) -> int:
    """Return the length of a fragment, the topic included."""
    overhead = 0 if fragment.topic is None else first_fragment_overhead_bytes(fragment.topic.encode())
    return overhead + len(fragment.payload)


def _reservation(fragment: DataFragment) -> int:
    """Return about the size of the whole message; the last fragment may be short, so allow for a usual one."""
    return fragment.fragment_count * max(_stride_of(fragment), 1400 if _is_last(fragment) else 0)


def _about(fragment: DataFragment) -> About:
    return About(fragment.fragment_count, fragment.priority, fragment.flags)


def _is_last(fragment: DataFragment) -> bool:
    return fragment.fragment_index == fragment.fragment_count - 1
