"""Stored messages on their receiver's side: which are known, which wait for an application, who has taken them.

A message is confirmed to its sender, and offered to applications, only once the file has it. It is kept until every
application that had subscribed to its topic by name has taken it, at least one; its id is remembered until the sender
says that it is settled (``floor``). Pure: the owner writes, reads and sends.
"""

from __future__ import annotations

import heapq
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from udp_mesh.core.envelope import DurableId

WINDOW_MESSAGES = 64  # given to one application and not yet taken
WINDOW_BYTES = 4 * 1024 * 1024
MAX_STORES = 4096
MAX_IDS = 65_536


@dataclass(slots=True)
class Kept:
    """A message that an application has to take. ``payload`` is None while only the file has it."""

    durable_id: DurableId
    source: str
    topic: str
    priority: int
    size_bytes: int
    received_ns: int
    deadline_s: float
    payload: bytes | None = None
    is_safe: bool = False
    is_taken: bool = False
    pending: set[int] = field(default_factory=set)


@dataclass(slots=True)
class _Application:
    """One connection: its topics by name, what it still gets, and what it was given and has not taken."""

    topics: set[str] = field(default_factory=set)
    queue: deque[DurableId] = field(default_factory=deque)
    given: dict[DurableId, int] = field(default_factory=dict)
    given_bytes: int = 0


class Inbox:
    """What was received and is not finished. ``taken`` collects what the owner removes from the file."""

    def __init__(self, *, limit_bytes: int, age_s: float) -> None:
        self.limit_bytes = limit_bytes
        self.age_s = age_s
        self.kept_bytes = 0
        self.counters: Counter[str] = Counter()
        self.taken: list[DurableId] = []
        self._floors: dict[int, int] = {}
        self._ids: dict[int, set[int]] = {}
        self._kept: dict[DurableId, Kept] = {}
        self._by_topic: dict[str, dict[DurableId, Kept]] = {}
        self._applications: dict[int, _Application] = {}
        self._victims: list[tuple[int, int, DurableId]] = []
        self._deadlines: list[tuple[float, DurableId]] = []
        self._order = 0

    def __len__(self) -> int:
        """Messages that wait for applications."""
        return len(self._kept)

    def restore(self, floors: dict[int, int], ids: Iterable[DurableId], kept: Iterable[Kept]) -> None:
        """Take over what the file held at the start."""
        self._floors.update(floors)
        for store, sequence in ids:
            self._ids.setdefault(store, set()).add(sequence)
        for message in kept:
            message.is_safe = True
            self._index(message)
            self._offer(message)

    def knows(self, durable_id: DurableId) -> bool:
        """Whether this message was received before."""
        store, sequence = durable_id
        return sequence < self._floors.get(store, 0) or sequence in self._ids.get(store, ())

    def is_committing(self, durable_id: DurableId) -> bool:
        """Whether the message was received and the file does not have it yet: too early to confirm."""
        kept = self._kept.get(durable_id)
        return kept is not None and not kept.is_safe

    def add(self, message: Kept) -> None:
        """Remember a message that is being written to the file; the oldest of the least urgent make room."""
        while self.kept_bytes + message.size_bytes > self.limit_bytes and self._victims:
            victim = self._kept.get(heapq.heappop(self._victims)[2])
            if victim is not None:
                self.counters["inbox_dropped_store_full"] += 1
                self._finish(victim)
        self._ids.setdefault(message.durable_id.store, set()).add(message.durable_id.sequence)
        self._index(message)

    def _index(self, message: Kept) -> None:
        self._kept[message.durable_id] = message
        self._by_topic.setdefault(message.topic, {})[message.durable_id] = message
        self.kept_bytes += message.size_bytes
        heapq.heappush(self._deadlines, (message.deadline_s, message.durable_id))

    def committed(self, message: Kept) -> None:
        """Offer a message to the applications: the file has it."""
        message.is_safe = True
        self._offer(message)

    def not_committed(self, message: Kept) -> None:
        """Forget a message that could not be written: its sender will repeat it."""
        self._ids.get(message.durable_id.store, set()).discard(message.durable_id.sequence)
        self._remove(message)

    def settle_below(self, store: int, floor: int) -> bool:
        """Forget the ids that the sender has settled; whether that is news."""
        if floor <= self._floors.get(store, 0):
            return False
        self._floors.pop(store, None)
        self._floors[store] = floor
        known = self._ids.get(store)
        if known:
            self._ids[store] = {sequence for sequence in known if sequence >= floor}
        while len(self._floors) > MAX_STORES:
            oldest = next(iter(self._floors))
            del self._floors[oldest]
            self._ids.pop(oldest, None)
        return True

    def has_room_for_id(self, store: int) -> bool:
        """Whether another id of this store can be remembered; a sender never has so many unsettled."""
        return len(self._ids.get(store, ())) < MAX_IDS

    # -- applications

    def subscribe(self, application: int, topic: str) -> None:
        """Offer an application what is kept of a topic and what comes."""
        state = self._applications.setdefault(application, _Application())
        if topic in state.topics:
            return
        state.topics.add(topic)
        for message in self._by_topic.get(topic, {}).values():
            if message.is_safe and not message.is_taken:
                message.pending.add(application)
                state.queue.append(message.durable_id)

    def unsubscribe(self, application: int, topic: str) -> None:
        """Offer an application nothing more of a topic."""
        state = self._applications.get(application)
        if state is None or topic not in state.topics:
            return
        state.topics.discard(topic)
        for message in list(self._by_topic.get(topic, {}).values()):
            self._release(application, message)

    def leave(self, application: int) -> None:
        """Forget an application; what only it had not taken is finished, what nobody took stays."""
        state = self._applications.pop(application, None)
        for topic in state.topics if state else ():
            for message in list(self._by_topic.get(topic, {}).values()):
                self._release(application, message)

    def _release(self, application: int, message: Kept) -> None:
        message.pending.discard(application)
        if message.is_taken and not message.pending:
            self._finish(message)

    def _offer(self, message: Kept) -> None:
        self._order += 1
        heapq.heappush(self._victims, (-message.priority, self._order, message.durable_id))
        for number, state in self._applications.items():
            if message.topic in state.topics:
                message.pending.add(number)
                state.queue.append(message.durable_id)

    def next_for(self, application: int) -> Kept | None:
        """Return what an application gets next; None if nothing waits or it has enough that it did not take."""
        state = self._applications.get(application)
        if state is None or len(state.given) >= WINDOW_MESSAGES or state.given_bytes >= WINDOW_BYTES:
            return None
        while state.queue:
            message = self._kept.get(state.queue[0])
            if message is not None and application in message.pending:
                return message
            state.queue.popleft()
        return None

    def give(self, application: int, message: Kept) -> None:
        """Note that the application was given what :meth:`next_for` returned."""
        state = self._applications[application]
        state.queue.popleft()
        state.given[message.durable_id] = message.size_bytes
        state.given_bytes += message.size_bytes

    def take(self, application: int, durable_id: DurableId) -> None:
        """Note that an application has taken a message."""
        state = self._applications.get(application)
        if state is not None:
            state.given_bytes -= state.given.pop(durable_id, 0)
        message = self._kept.get(durable_id)
        if message is not None and application in message.pending:
            message.is_taken = True
            self._release(application, message)

    # -- ends

    def handle_timer(self, *, now: float) -> None:
        """Drop what nobody took in time."""
        while self._deadlines and self._deadlines[0][0] <= now:
            message = self._kept.get(heapq.heappop(self._deadlines)[1])
            if message is not None:
                self.counters["inbox_dropped_expired"] += 1
                self._finish(message)

    def next_timer(self) -> float | None:
        """Return when to call :meth:`handle_timer`."""
        while self._deadlines and self._deadlines[0][1] not in self._kept:
            heapq.heappop(self._deadlines)
        return self._deadlines[0][0] if self._deadlines else None

    def lost(self, message: Kept) -> None:
        """Give up a message whose payload the file no longer has."""
        if message.durable_id in self._kept:
            self.counters["inbox_dropped_store_corrupted"] += 1
            self._finish(message)

    def _finish(self, message: Kept) -> None:
        self._remove(message)
        self.taken.append(message.durable_id)

    def _remove(self, message: Kept) -> None:
        del self._kept[message.durable_id]
        topic = self._by_topic[message.topic]
        del topic[message.durable_id]
        if not topic:
            del self._by_topic[message.topic]
        self.kept_bytes -= message.size_bytes
        message.payload = None
