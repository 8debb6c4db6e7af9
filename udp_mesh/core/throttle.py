"""Holds messages of topics with a rate limit back from the scheduler until their topic may send again.

A topic earns nothing while it is silent: after a pause one message leaves at once, the next when the limit allows it.
What is held counts as queued; ``keep: latest`` and lifetimes thin it out as ever. A message's copies leave together.
Source: the virtual scheduling form of the generic cell rate algorithm, ITU-T I.371, with a burst of one message.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from udp_mesh.core.events import Event, MessageHeld, MessageReleased
from udp_mesh.core.messages import Transfer
from udp_mesh.core.scheduler import Scheduler
from udp_mesh.core.settings import TopicPolicy

_LATE_S = 0.02


@dataclass(slots=True)
class _Topic:
    free_at_s: float
    held: deque[list[Transfer]] = field(default_factory=deque)


class Throttle:
    """Stands before the scheduler; tells ``events`` what it holds and lets go."""

    def __init__(self, scheduler: Scheduler, events: deque[Event]) -> None:
        self._scheduler = scheduler
        self._events = events
        self._topics: dict[str, _Topic] = {}

    def push(self, copies: list[Transfer], *, now: float) -> None:
        """Queue one message's transfers, now or when its topic may send again."""
        message = copies[0].message
        if not message.policy.is_limited:
            for transfer in copies:
                self._scheduler.push(transfer)
            return
        topic = self._topics.setdefault(message.topic, _Topic(now))
        while topic.held and all(transfer.is_done for transfer in topic.held[0]):
            topic.held.popleft()  # replaced or expired while it waited
        topic.held.append(copies)
        self._release(topic, fresh=copies, now=now)
        if topic.held and topic.held[-1] is copies:
            self._events.extend(
                MessageHeld(now, message.published_id, message.topic, message.policy.priority, transfer.peer)
                for transfer in copies
            )

    def replace(self, old: Transfer, fresh: Transfer) -> bool:
        """Hold a transfer in another's place; whether the other was held."""
        topic = self._topics.get(old.message.topic)
        for copies in topic.held if topic is not None else ():
            if old in copies:
                copies[copies.index(old)] = fresh
                return True
        return False

    def release(self, *, now: float) -> None:
        """Queue what may be sent by now."""
        for name, topic in list(self._topics.items()):
            self._release(topic, now=now)
            if not topic.held and topic.free_at_s <= now:
                del self._topics[name]

    def _release(self, topic: _Topic, *, fresh: list[Transfer] | None = None, now: float) -> None:
        """Queue what may be sent by now; ``fresh`` was published just now, so nobody was told that it is held."""
        while topic.held and topic.free_at_s <= now:
            released = topic.held.popleft()
            copies = [transfer for transfer in released if not transfer.is_done]
            if not copies:
                continue
            message = copies[0].message
            cost_s = interval_s(message.policy, size_bytes=message.size_bytes * len(copies))
            # What a timer is late is made up, what a pause left over is not: that would be a burst.
            topic.free_at_s = max(topic.free_at_s, now - _LATE_S) + cost_s
            for transfer in copies:
                self._scheduler.push(transfer)
                if released is not fresh:
                    self._events.append(_released(transfer, now=now))

    def next_timer(self) -> float | None:
        """Return when something that is held may be sent."""
        return min((topic.free_at_s for topic in self._topics.values() if topic.held), default=None)


def _released(transfer: Transfer, *, now: float) -> MessageReleased:
    message = transfer.message
    held_s = now - message.queued_at_s
    return MessageReleased(now, message.published_id, message.topic, message.policy.priority, transfer.peer, held_s)


def interval_s(policy: TopicPolicy, *, size_bytes: int) -> float:
    """Return how long a topic is silent after a message of so many payload bytes, over all destinations."""
    by_count_s = 1 / policy.rate_limit_hz if policy.rate_limit_hz else 0.0
    by_size_s = 8 * size_bytes / policy.rate_limit_bps if policy.rate_limit_bps else 0.0
    return max(by_count_s, by_size_s)
