"""What waits at a bridge for a slow carrier: the most urgent leaves first, the least urgent is dropped first."""

from __future__ import annotations

from collections import deque

from udp_mesh.core.datagram import Datagram

QUEUE_S = 4.0  # of the carrier's rate
LEAST_QUEUE_BYTES = 4096
MAX_WAIT_S = 15.0  # after that long it has left once more


class BridgeQueue:
    """Datagrams of other nodes, by priority, then in order of arrival."""

    def __init__(self, rate_bps: float) -> None:
        self.limit_bytes = max(LEAST_QUEUE_BYTES, int(rate_bps / 8 * QUEUE_S))
        self.waiting_bytes = 0
        self._by_priority: dict[int, deque[tuple[float, Datagram]]] = {}

    def push(self, datagram: Datagram, *, now: float) -> int:
        """Queue a datagram; return how many were dropped to make room: the oldest of the least urgent first."""
        self._by_priority.setdefault(datagram.priority, deque()).append((now, datagram))
        self.waiting_bytes += len(datagram.data)
        dropped = 0
        while self.waiting_bytes > self.limit_bytes:
            self._pop(max(self._by_priority))
            dropped += 1
        return dropped

    def forget_stale(self, *, now: float) -> int:
        """Drop what has waited for too long, and say how many."""
        dropped = 0
        for priority in list(self._by_priority):
            while priority in self._by_priority and self._by_priority[priority][0][0] < now - MAX_WAIT_S:
                self._pop(priority)
                dropped += 1
        return dropped

    @property
    def head_priority(self) -> int | None:
        """Priority of what leaves next; None if nothing waits."""
        return min(self._by_priority, default=None)

    def pop(self) -> Datagram:
        """Take what leaves next; there has to be something."""
        return self._pop(min(self._by_priority))

    def _pop(self, priority: int) -> Datagram:
        waiting = self._by_priority[priority]
        _since_s, datagram = waiting.popleft()
        if not waiting:
            del self._by_priority[priority]
        self.waiting_bytes -= len(datagram.data)
        return datagram
