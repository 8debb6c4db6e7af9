"""When the lifetimes of transfers end."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from udp_mesh.core.messages import Transfer

_COMPACT_FROM = 256


class Deadlines:
    """A heap that forgets finished transfers: long lifetimes must not keep them in memory."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Transfer]] = []
        self._compact_at = _COMPACT_FROM

    def __len__(self) -> int:
        """Entries held, finished ones included."""
        return len(self._heap)

    def watch(self, transfer: Transfer) -> None:
        """Report a transfer when its message's lifetime is over, if it has one."""
        deadline_s = transfer.message.deadline_s
        if deadline_s is None:
            return
        heapq.heappush(self._heap, (deadline_s, transfer.key[2], transfer))
        if len(self._heap) >= self._compact_at:
            self._heap = [entry for entry in self._heap if not entry[2].is_done]
            heapq.heapify(self._heap)
            self._compact_at = max(_COMPACT_FROM, 2 * len(self._heap))

    def due(self, *, now: float) -> Iterator[Transfer]:
        """Yield the transfers whose time is over."""
        while self._heap and (self._heap[0][0] <= now or self._heap[0][2].is_done):
            yield heapq.heappop(self._heap)[2]

    def next_timer(self) -> float | None:
        """Return when the next lifetime ends."""
        return self._heap[0][0] if self._heap else None
