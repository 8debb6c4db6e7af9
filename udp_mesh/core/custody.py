"""Stored messages on their sender's side: what is safe in the file, what is on its way, what has been confirmed.

Theory of operation. A message is COMMITTING until the file has it, then WAITING. While its destination is online it is
handed to the transport (FED), a limited amount at a time, so that a more urgent one can still pass. The transport's
acknowledgement (SENT) only says that the receiver's daemon had it in memory; the message ends when the receiver
confirms that it is safe there. A restart of the receiver, a full queue or a missing confirmation leads back to WAITING;
the receiver knows a repeated message by its durable id.

Nothing here touches files or clocks: the owner writes what :class:`Custody` asks for and tells it the outcome.
"""

from __future__ import annotations

import heapq
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass

from udp_mesh.core.events import DropReason, MessageConfirmed, MessageStored, RefusalReason, StoredDropped
from udp_mesh.core.outbox import Refused
from udp_mesh.core.settings import Keep, TopicPolicy
from udp_mesh.core.stored import Phase, Stored

FEED_BYTES = 256 * 1024  # of one destination in the transport, unless a single message is larger
FEED_MESSAGES = 256
RESEND_AFTER_S = 10.0  # without a confirmation although the transport has delivered it
RETRY_AFTER_S = 0.5  # after the transport refused or dropped it
MAX_STORED_MESSAGES = 65_536


@dataclass(slots=True)
class _Destination:
    """Unsettled messages of one destination, in order of their sequence, and what of them the transport holds."""

    stored: dict[int, Stored]
    waiting: list[tuple[int, int]]  # heap of priority and sequence
    fed: dict[int, Stored]


class Custody:
    """The unsettled messages of one store.

    ``forgotten`` collects sequences that the owner removes from the file, ``withdrawn`` what it takes back from the
    transport, so that a message reported as dropped does not arrive all the same.
    """

    def __init__(self, *, limit_bytes: int, age_s: float) -> None:
        self.limit_bytes = limit_bytes
        self.age_s = age_s
        self.next_sequence = 1
        self.stored_bytes = 0
        self.events: deque[MessageStored | MessageConfirmed | StoredDropped] = deque()
        self.counters: Counter[str] = Counter()
        self.forgotten: list[int] = []
        self.withdrawn: list[tuple[Stored, DropReason]] = []
        self._stored: dict[int, Stored] = {}
        self._destinations: dict[str, _Destination] = {}
        self._victims: list[tuple[int, int]] = []  # heap: least urgent first, then oldest
        self._timers: list[tuple[float, int]] = []

    def __len__(self) -> int:
        """Messages that are not settled."""
        return len(self._stored)

    def restore(self, messages: Iterable[Stored]) -> None:
        """Take over what the file held at the start, in order of sequence."""
        for message in messages:
            message.phase = Phase.WAITING
            self.next_sequence = max(self.next_sequence, message.sequence + 1)
            self._index(message)
            heapq.heappush(self._destinations[message.peer].waiting, (message.policy.priority, message.sequence))

    def admit(
        self,
        topic: str,
        size_bytes: int,
        peers: Iterable[str],
        policy: TopicPolicy,
        *,
        payload: bytes | None = None,
        original_bytes: int | None = None,
        now: float,
    ) -> list[Stored]:
        """Make room for a message and return one entry per destination, to be written to the file.

        Raises:
            Refused: It is larger than the store, or all that is stored is more urgent.
        """
        names = list(peers)
        if size_bytes * len(names) > self.limit_bytes:
            raise Refused(RefusalReason.TOO_LARGE)
        if policy.keep is Keep.LATEST:
            self._supersede(topic, names, now=now)
        self._make_room(size_bytes * len(names), len(names), policy.priority, now=now)
        lifetime_s = self.age_s if policy.lifetime_s is None else min(policy.lifetime_s, self.age_s)
        entries = []
        for name in names:
            entry = Stored(self.next_sequence, name, topic, policy, size_bytes, now, now + lifetime_s, original_bytes)
            entry.payload = payload
            self.next_sequence += 1
            self._index(entry)
            entries.append(entry)
        return entries

    def _index(self, entry: Stored) -> None:
        self._stored[entry.sequence] = entry
        self.stored_bytes += entry.size_bytes
        self._destinations.setdefault(entry.peer, _Destination({}, [], {})).stored[entry.sequence] = entry
        heapq.heappush(self._victims, (-entry.policy.priority, entry.sequence))
        heapq.heappush(self._timers, (entry.deadline_s, entry.sequence))

    def _supersede(self, topic: str, peers: list[str], *, now: float) -> None:
        for name in peers:
            destination = self._destinations.get(name)
            for entry in list(destination.stored.values()) if destination else ():
                if entry.topic == topic and entry.phase in (Phase.WAITING, Phase.COMMITTING):
                    self._drop(entry, DropReason.SUPERSEDED, now=now)

    def _make_room(self, size_bytes: int, count: int, priority: int, *, now: float) -> None:
        while self.stored_bytes + size_bytes > self.limit_bytes or len(self._stored) + count > MAX_STORED_MESSAGES:
            while self._victims and self._victims[0][1] not in self._stored:
                heapq.heappop(self._victims)
            if not self._victims or -self._victims[0][0] < priority:
                raise Refused(RefusalReason.STORE_FULL)
            self._drop(self._stored[heapq.heappop(self._victims)[1]], DropReason.STORE_FULL, now=now)

    def committed(self, entry: Stored, *, now: float) -> None:
        """Note that the file has a message; it may leave now."""
        if entry.is_done:
            return
        what = (entry.sequence, entry.topic, entry.policy.priority, entry.size_bytes, entry.peer)
        self.events.append(MessageStored(now, *what))
        self._wait(entry)

    def not_committed(self, entry: Stored) -> None:
        """Forget a message that could not be written; its publisher is told by a refusal."""
        if not entry.is_done:
            self._remove(entry)

    def _wait(self, entry: Stored) -> None:
        destination = self._destinations[entry.peer]
        destination.fed.pop(entry.sequence, None)
        entry.phase = Phase.WAITING
        heapq.heappush(destination.waiting, (entry.policy.priority, entry.sequence))

    def holds(self, sequence: int, peer: str) -> bool:
        """Whether a message for this destination is not settled."""
        entry = self._stored.get(sequence)
        return entry is not None and entry.peer == peer

    def destinations(self) -> list[str]:
        """Return every destination for which something is stored."""
        return [name for name, destination in self._destinations.items() if destination.stored]

    def next_to_feed(self, peer: str, *, now: float) -> Stored | None:
        """Return the message that the transport should get next; None if nothing waits or it holds enough."""
        destination = self._destinations.get(peer)
        while destination is not None and destination.waiting:
            priority, sequence = destination.waiting[0]
            entry = self._stored.get(sequence)
            if entry is None or entry.phase is not Phase.WAITING:
                heapq.heappop(destination.waiting)
                continue
            if entry.again_at_s > now:
                return None
            as_urgent = [fed for fed in destination.fed.values() if fed.policy.priority <= priority]
            if len(as_urgent) >= FEED_MESSAGES or sum(fed.size_bytes for fed in as_urgent) >= FEED_BYTES:
                return None
            return entry
        return None

    def floor(self, peer: str) -> int:
        """Return the sequence below which everything for this destination is settled."""
        destination = self._destinations.get(peer)
        return next(iter(destination.stored), self.next_sequence) if destination else self.next_sequence

    def fed(self, entry: Stored) -> None:
        """Note that the transport has a message."""
        entry.phase = Phase.FED
        self._destinations[entry.peer].fed[entry.sequence] = entry

    def refused(self, entry: Stored, *, now: float) -> None:
        """Note that the transport did not take a message; it waits a moment."""
        entry.again_at_s = now + RETRY_AFTER_S
        heapq.heappush(self._timers, (entry.again_at_s, entry.sequence))
        if entry.phase is Phase.FED:
            self._wait(entry)

    def on_acked(self, sequence: int, *, now: float) -> None:
        """Take the transport's acknowledgement: the receiver's daemon has the message in memory."""
        entry = self._stored.get(sequence)
        if entry is None or entry.phase is not Phase.FED:
            return
        self._destinations[entry.peer].fed.pop(sequence, None)
        entry.phase = Phase.SENT
        entry.payload = None
        entry.again_at_s = now + RESEND_AFTER_S
        heapq.heappush(self._timers, (entry.again_at_s, sequence))

    def on_dropped(self, sequence: int, reason: DropReason, *, now: float) -> None:
        """Take back what the transport dropped."""
        entry = self._stored.get(sequence)
        if entry is None or entry.phase is not Phase.FED:
            return
        if reason is DropReason.PEER_RESTARTED:
            self._wait(entry)
        else:
            self.refused(entry, now=now)

    def on_peer_restarted(self, peer: str) -> None:
        """Send everything again that the receiver had not confirmed."""
        destination = self._destinations.get(peer)
        for entry in list(destination.stored.values()) if destination else ():
            if entry.phase is Phase.SENT:
                self._wait(entry)
                entry.again_at_s = 0.0

    def on_confirmed(self, sequence: int, peer: str, *, now: float) -> bool:
        """End a message that is safe at its receiver; False if it is none of ours, or known to be settled."""
        if not self.holds(sequence, peer):
            return False
        entry = self._stored[sequence]
        self._forget(entry)
        self.counters["stored_confirmed"] += 1
        self.events.append(
            MessageConfirmed(now, sequence, entry.topic, entry.policy.priority, peer, now - entry.queued_at_s)
        )
        return True

    def lost(self, entry: Stored, *, now: float) -> None:
        """Give up a message whose payload the file no longer has."""
        if not entry.is_done:
            self._drop(entry, DropReason.STORE_CORRUPTED, now=now)

    def handle_timer(self, *, now: float) -> None:
        """End messages whose lifetime is over; send those again that stayed unconfirmed."""
        while self._timers and self._timers[0][0] <= now:
            entry = self._stored.get(heapq.heappop(self._timers)[1])
            if entry is None:
                continue
            if entry.deadline_s <= now:
                self._drop(entry, DropReason.EXPIRED, now=now)
            elif entry.phase is Phase.SENT and entry.again_at_s <= now:
                self.counters["stored_resent"] += 1
                self._wait(entry)

    def next_timer(self) -> float | None:
        """Return when to call :meth:`handle_timer`."""
        while self._timers and self._timers[0][1] not in self._stored:
            heapq.heappop(self._timers)
        return self._timers[0][0] if self._timers else None

    def depths(self) -> dict[str, int]:
        """Return the unsettled messages by topic."""
        return dict(Counter(entry.topic for entry in self._stored.values()))

    def _drop(self, entry: Stored, reason: DropReason, *, now: float) -> None:
        may_have_arrived = entry.phase in (Phase.FED, Phase.SENT)
        if entry.phase is Phase.FED:
            self.withdrawn.append((entry, reason))
        self._forget(entry)
        self.counters[f"stored_dropped_{reason.value}"] += 1
        what = (entry.sequence, entry.topic, entry.policy.priority, entry.size_bytes, entry.peer)
        self.events.append(StoredDropped(now, *what, reason, may_have_arrived))

    def _forget(self, entry: Stored) -> None:
        self._remove(entry)
        self.forgotten.append(entry.sequence)

    def _remove(self, entry: Stored) -> None:
        entry.is_done = True
        entry.payload = None
        destination = self._destinations[entry.peer]
        del self._stored[entry.sequence]
        del destination.stored[entry.sequence]
        destination.fed.pop(entry.sequence, None)
        self.stored_bytes -= entry.size_bytes
