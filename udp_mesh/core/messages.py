"""Outgoing messages: how one buffer divides into fragments, and what has become of them at each destination."""

from __future__ import annotations

import heapq
from collections.abc import Iterable

from udp_mesh.core import wire
from udp_mesh.core.settings import Keep, Offline, Reliability, TopicPolicy

SortKey = tuple[int, float, int]
_SENT, _ACKED, _WAITS_AGAIN, _COPY_WAITS = range(4)  # state of a fragment; one that was never sent counts as sent
_ACKED_BYTE = bytes((_ACKED,))
_SMALL_FRAGMENTS = 4  # retransmissions of messages up to this long leave twice


class Message:
    """A published message. Fragments are ranges of ``payload``; nothing is copied before it is sent.

    ``message_id`` names it on the wire, ``published_id`` in every event and towards applications. They differ once the
    message was begun anew: its receiver must not take new fragments for the rest of old ones.
    """

    __slots__ = (
        "_rest_bytes",
        "deadline_s",
        "first_bytes",
        "flags",
        "fragment_count",
        "message_id",
        "payload",
        "policy",
        "published_id",
        "queued_at_s",
        "size_bytes",
        "token",
        "topic",
        "topic_bytes",
    )

    def __init__(
        self,
        message_id: int,
        topic: str,
        payload: bytes | memoryview,
        policy: TopicPolicy,
        *,
        datagram_bytes: int,
        flags: int = 0,
        token: int = 0,
        published_id: int | None = None,
        now: float,
    ) -> None:
        self.message_id = message_id
        self.published_id = message_id if published_id is None else published_id
        self.topic = topic
        self.topic_bytes = topic.encode()
        self.payload = memoryview(payload)
        self.size_bytes = len(payload)
        self.policy = policy
        self.flags = flags
        self.token = token
        self.queued_at_s = now
        self.deadline_s = None if policy.lifetime_s is None else now + policy.lifetime_s
        self._rest_bytes = datagram_bytes - wire.HEADER_BYTES - wire.DATA_BYTES
        self.first_bytes = self._rest_bytes - wire.first_fragment_overhead_bytes(self.topic_bytes)
        beyond = max(0, self.size_bytes - self.first_bytes)
        self.fragment_count = 1 + -(-beyond // self._rest_bytes)

    def cut_anew(self, message_id: int, *, datagram_bytes: int) -> Message:
        """Return the same message with another id on the wire, and perhaps with other fragments."""
        return Message(
            message_id,
            self.topic,
            self.payload,
            self.policy,
            datagram_bytes=datagram_bytes,
            flags=self.flags,
            token=self.token,
            published_id=self.published_id,
            now=self.queued_at_s,
        )

    @property
    def largest_bytes(self) -> int:
        """Length of its longest datagram, when nothing else is in it."""
        return wire.HEADER_BYTES + max(self.fragment_bytes(0), self.fragment_bytes(min(1, self.fragment_count - 1)))

    @property
    def is_reliable(self) -> bool:
        """Whether lost fragments are sent again."""
        return self.policy.reliability is Reliability.RELIABLE

    @property
    def keeps_latest(self) -> bool:
        """Whether a newer message of the topic replaces this one."""
        return self.policy.keep is Keep.LATEST

    @property
    def survives_offline(self) -> bool:
        """Whether it waits, as the newest of its topic, for a peer that is offline."""
        return self.policy.offline is Offline.LATEST

    @property
    def leaves_twice(self) -> bool:
        """Whether fragments leave again before anything is known of their arrival: always, or when retransmitted."""
        return self.fragment_count <= _SMALL_FRAGMENTS or self.policy.redundancy > 1

    def payloads(self, index: int, count: int) -> list[memoryview]:
        """Return what ``count`` fragments from ``index`` on carry; the last fragment must not be among them."""
        size, payload = self._rest_bytes, self.payload
        start = self.first_bytes + (index - 1) * size
        views = [payload[at : at + size] for at in range(start, start + count * size, size)]
        if index == 0:
            views[0] = payload[: self.first_bytes]
        return views

    @property
    def topic_prefix(self) -> bytes:
        """What precedes the payload of fragment 0."""
        return bytes((len(self.topic_bytes),)) + self.topic_bytes

    def fragment(self, index: int) -> tuple[bytes, memoryview]:
        """Return the wire header and the payload of one fragment."""
        start = 0 if index == 0 else self.first_bytes + (index - 1) * self._rest_bytes
        end = min(self.size_bytes, self.first_bytes + index * self._rest_bytes)
        header = wire.encode_data_header(
            message_id=self.message_id,
            priority=self.policy.priority,
            index=index,
            count=self.fragment_count,
            payload_bytes=end - start,
            topic=self.topic_bytes,
            flags=self.flags,
        )
        return header, self.payload[start:end]

    def fragment_bytes(self, index: int) -> int:
        """Return the length of a fragment on the wire, its header included."""
        if index == 0:
            overhead = wire.first_fragment_overhead_bytes(self.topic_bytes)
            return wire.DATA_BYTES + overhead + min(self.size_bytes, self.first_bytes)
        start = self.first_bytes + (index - 1) * self._rest_bytes
        return wire.DATA_BYTES + min(self.size_bytes - start, self._rest_bytes)


class Transfer:
    """One message on its way to one destination. The destination ``all`` is never acknowledged."""

    __slots__ = (
        "_again",
        "_copies_left",
        "_copies_planned",
        "_last_number",
        "_state",
        "acked_count",
        "is_done",
        "is_queued",
        "key",
        "message",
        "next_index",
        "peer",
    )

    def __init__(self, message: Message, peer: str, key: SortKey) -> None:
        self.message = message
        self.peer = peer
        self.key = key
        self.next_index = 0
        self.is_done = False
        self.is_queued = False  # in the scheduler's heap
        self.acked_count = 0
        self._state = bytearray(message.fragment_count)
        self._again: list[int] = []
        self._last_number: dict[int, int] = {}  # of fragments sent more than once: their newest packet
        self._copies_left: dict[int, int] = {}
        self._copies_planned: set[int] = set()

    def __lt__(self, other: Transfer) -> bool:
        return self.key < other.key

    @property
    def is_started(self) -> bool:
        """Whether any fragment has left."""
        return self.next_index > 0

    @property
    def is_fully_sent(self) -> bool:
        """Whether every fragment has left at least once."""
        return self.next_index >= self.message.fragment_count

    @property
    def is_complete(self) -> bool:
        """Whether every fragment is acknowledged."""
        return self.acked_count == self.message.fragment_count

    @property
    def retransmits_next(self) -> bool:
        """Whether the next fragment to leave has left before, and no mere copy is meant."""
        return bool(self._again) and self._state[self._again[0]] != _COPY_WAITS

    @property
    def copies_next(self) -> bool:
        """Whether the next fragment to leave is a mere copy: nothing is known yet of the arrival of the one before."""
        return bool(self._again) and self._state[self._again[0]] == _COPY_WAITS

    def peek(self) -> int | None:
        """Return the fragment to send next: lost ones first, then in order; None if nothing waits."""
        while self._again:
            if self._state[self._again[0]] >= _WAITS_AGAIN:
                return self._again[0]
            heapq.heappop(self._again)  # arrived meanwhile
        return self.next_index if self.next_index < self.message.fragment_count else None

    def run_length(self, limit: int) -> int:
        """Return how many fragments from :meth:`peek` on may leave as one run: consecutive and not the last one."""
        last = self.message.fragment_count - 1
        index = self.peek()
        if index is None:
            return 0
        end = min(index + limit, last)
        if not self._again:
            return max(0, end - index)
        at = index
        while at < end and self._state[at] == _WAITS_AGAIN:
            at += 1
        return at - index

    def advance(self, packet_number: int, count: int = 1) -> None:
        """Count ``count`` fragments from :meth:`peek` on as sent, in the packets from this number on."""
        if not self._again:
            self.next_index += count
            return
        for number in range(packet_number, packet_number + count):
            index = heapq.heappop(self._again)
            self._state[index] = _SENT
            self._last_number[index] = number

    def acknowledge(self, index: int, count: int = 1) -> bool:
        """Note that ``count`` fragments have arrived; False if that was known of all of them."""
        end = index + count
        new = count - self._state.count(_ACKED, index, end)
        if new:
            self._state[index:end] = _ACKED_BYTE * count
            self.acked_count += new
        return new > 0

    def send_again(self, indices: Iterable[int]) -> bool:
        """Queue fragments once more, unless they have arrived or wait already; True if any was queued."""
        added = False
        for index in indices:
            if self._state[index] == _SENT:
                self._state[index] = _WAITS_AGAIN
                heapq.heappush(self._again, index)
                added = True
                if self.message.leaves_twice:
                    self._copies_left[index] = max(self.message.policy.redundancy - 1, 1)
        return added

    def take_copy(self, index: int) -> bool:
        """Whether a fragment that leaves now is to leave once more; counts that copy as planned."""
        left = self._copies_left.get(index, self.message.policy.redundancy - 1)
        if left <= 0 or index in self._copies_planned:
            return False
        self._copies_left[index] = left - 1
        self._copies_planned.add(index)
        return True

    def send_copy(self, index: int) -> bool:
        """Queue a planned copy, unless the fragment has arrived or waits already; True if it was queued."""
        self._copies_planned.discard(index)
        if self._state[index] != _SENT:
            return False
        self._state[index] = _COPY_WAITS
        heapq.heappush(self._again, index)
        return True

    def has_copy(self, index: int) -> bool:
        """Whether a copy of a fragment is still to leave."""
        return index in self._copies_planned or self._state[index] == _COPY_WAITS

    def was_repeated_after(self, index: int, packet_number: int) -> bool:
        """Whether a newer packet than this one carries the fragment too."""
        return self._last_number.get(index, -1) > packet_number

    def start_over(self) -> None:
        """Forget all progress: the receiver has lost what it had."""
        self.next_index = 0
        self.acked_count = 0
        self._state = bytearray(self.message.fragment_count)
        self._again.clear()
        self._last_number.clear()
        self._copies_left.clear()
        self._copies_planned.clear()
