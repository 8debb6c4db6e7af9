"""What waits at a node by priority, told from its daemon's events. Pure.

Every ``message_queued`` for a node is followed by one ``message_acked`` or ``message_dropped`` of the same message and
peer; a message for everybody (``all``) has no such end and does not count. What a store holds is told by
``message_stored`` until ``message_confirmed`` or ``stored_dropped``.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

_EVERYBODY = "all"
_ENDS = ("message_acked", "message_dropped")
_STORE_ENDS = ("message_confirmed", "stored_dropped")
_MOST = 100_000  # an end whose event was lost must not cost memory for ever


@dataclass(frozen=True, slots=True)
class Waiting:
    """Messages and bytes."""

    messages: int = 0
    size_bytes: int = 0

    def plus(self, size_bytes: int) -> Waiting:
        """With one message more."""
        return Waiting(self.messages + 1, self.size_bytes + size_bytes)


@dataclass(slots=True)
class Queues:
    """One node's messages that wait for their confirmation."""

    dropped: dict[str, int] = field(default_factory=dict)  # by reason
    _queued: dict[tuple[str, int], tuple[int, int]] = field(default_factory=dict)  # (peer, id) -> priority, size
    _stored: dict[tuple[str, int], tuple[int, int]] = field(default_factory=dict)

    def take(self, event: Mapping[str, object]) -> None:
        """Take note of an event of the daemon."""
        name, peer = str(event.get("event")), str(event.get("peer", ""))
        if name == "message_queued" and peer != _EVERYBODY:
            _put(self._queued, (peer, _int(event, "message_id")), event)
        elif name in _ENDS:
            self._queued.pop((peer, _int(event, "message_id")), None)
        elif name == "message_stored":
            _put(self._stored, (peer, _int(event, "sequence")), event)
        elif name in _STORE_ENDS:
            self._stored.pop((peer, _int(event, "sequence")), None)
        if name in ("message_dropped", "stored_dropped"):
            reason = str(event.get("reason"))
            self.dropped[reason] = self.dropped.get(reason, 0) + 1

    def restarted(self) -> None:
        """The daemon's memory is gone; its store is not."""
        self._queued.clear()

    def by_priority(self) -> dict[int, Waiting]:
        """What waits, most urgent first."""
        return _by_priority(self._queued.values())

    def stored(self) -> dict[int, Waiting]:
        """What the store holds for peers that are away, most urgent first."""
        return _by_priority(self._stored.values())

    def offline(self, online: Collection[str]) -> Waiting:
        """What waits, in memory, for peers that are not online."""
        total = Waiting()
        for (peer, _), (_, size_bytes) in self._queued.items():
            if peer not in online:
                total = total.plus(size_bytes)
        return total


def _put(where: dict[tuple[str, int], tuple[int, int]], key: tuple[str, int], event: Mapping[str, object]) -> None:
    where[key] = (_int(event, "priority"), _int(event, "size_bytes"))
    if len(where) > _MOST:
        where.pop(next(iter(where)))


def _int(event: Mapping[str, object], key: str) -> int:
    value = event.get(key)
    return int(value) if isinstance(value, int | float) else 0


def _by_priority(entries: Collection[tuple[int, int]]) -> dict[int, Waiting]:
    found: dict[int, Waiting] = {}
    for priority, size_bytes in entries:
        found[priority] = found.get(priority, Waiting()).plus(size_bytes)
    return dict(sorted(found.items()))
