"""What happened: counters of everything, and events for the owner, bounded both."""

from __future__ import annotations

from collections import deque

from wnet.core.events import Count, Drop, DuplicateAddress, Event, FrameDropped

_MAX_EVENTS = 1000
_DROPS_PER_S = 100
_MAX_ADDRESSES = 64


class Journal:
    """Counters by word, and the newest thousand events not told yet."""

    def __init__(self) -> None:
        self.counts: dict[Count | Drop, int] = dict.fromkeys((*Count, *Drop), 0)
        self._events: deque[Event] = deque(maxlen=_MAX_EVENTS)
        self._drops_since = float("-inf")
        self._drops_told = 0
        self._conflicts: dict[bytes, float] = {}

    def count(self, what: Count | Drop, number: int = 1) -> None:
        """Count something."""
        self.counts[what] += number

    def tell(self, event: Event) -> None:
        """Keep an event until it is asked for."""
        self._events.append(event)

    def drop(self, reason: Drop, source: bytes, destination: bytes, size_bytes: int, *, now: float) -> None:
        """Count a frame of data that ended here, and tell it unless very many do."""
        self.counts[reason] += 1
        if now - self._drops_since >= 1.0:
            self._drops_since, self._drops_told = now, 0
        self._drops_told += 1
        if self._drops_told <= _DROPS_PER_S:
            self._events.append(FrameDropped(now, source, destination, size_bytes, reason))

    def conflict(self, mac: bytes, heard_from: bytes, *, now: float) -> None:
        """Tell, at most once a second per address, that two nodes have one address."""
        if now - self._conflicts.get(mac, float("-inf")) < 1.0:
            return
        if len(self._conflicts) >= _MAX_ADDRESSES:
            self._conflicts.pop(next(iter(self._conflicts)))
        self._conflicts[mac] = now
        self._events.append(DuplicateAddress(now, mac, heard_from))

    def next_event(self) -> Event | None:
        """Return the oldest event not told yet."""
        return self._events.popleft() if self._events else None
