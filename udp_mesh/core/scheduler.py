"""The node's one queue: which fragment leaves next, over all peers and broadcast.

Strictly by priority, then by deadline, then by order of publication; a message is preempted between fragments. A
destination that cannot take more now (window, pace, offline) is passed over, so that it does not block the others.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator

from udp_mesh.core.messages import Message, SortKey, Transfer

_NO_DEADLINE = float("inf")
_COMPACT_FROM = 64


class Scheduler:
    """Transfers that have something to send, one heap per destination."""

    def __init__(self) -> None:
        self._heaps: dict[str, list[Transfer]] = {}
        self._compact_at: dict[str, int] = {}

    @staticmethod
    def key(message: Message, *, order: int, prioritise: bool) -> SortKey:
        """Return the place of a message in the queue; lower leaves first."""
        if not prioritise:
            return (0, 0.0, order)
        deadline_s = _NO_DEADLINE if message.deadline_s is None else message.deadline_s
        return (message.policy.priority, deadline_s, order)

    def push(self, transfer: Transfer) -> None:
        """Queue a transfer (again); harmless if it is queued."""
        if not transfer.is_queued and not transfer.is_done:
            transfer.is_queued = True
            heap = self._heaps.setdefault(transfer.peer, [])
            heapq.heappush(heap, transfer)
            if len(heap) >= self._compact_at.get(transfer.peer, _COMPACT_FROM):
                self._compact(transfer.peer)

    def _compact(self, peer: str) -> None:
        """Forget finished transfers inside the heap: an offline peer's are never at its top."""
        heap = [transfer for transfer in self._heaps[peer] if not transfer.is_done]
        heapq.heapify(heap)
        self._heaps[peer] = heap
        self._compact_at[peer] = max(_COMPACT_FROM, 2 * len(heap))

    def head(self, peer: str) -> Transfer | None:
        """Return what one destination would send next."""
        heap = self._heaps.get(peer)
        while heap:
            transfer = heap[0]
            if not transfer.is_done and transfer.peek() is not None:
                return transfer
            heapq.heappop(heap).is_queued = False
        return None

    def heads(self) -> Iterator[Transfer]:
        """Return the next transfer of every destination that has one, in no order."""
        for peer in list(self._heaps):
            transfer = self.head(peer)
            if transfer is None:
                del self._heaps[peer]
            else:
                yield transfer

    def longest_waiting(self, priority: int, can_send: Callable[[Transfer], bool]) -> Transfer | None:
        """Return the oldest of the transfers less urgent than ``priority`` that can leave now; looks at all of them."""
        waiting = [
            transfer
            for heap in self._heaps.values()
            for transfer in heap
            if not transfer.is_done and transfer.message.policy.priority > priority and transfer.peek() is not None
        ]
        return next((t for t in sorted(waiting, key=lambda t: t.key[2]) if can_send(t)), None)

    def pick(self, can_send: Callable[[Transfer], bool]) -> Transfer | None:
        """Return the most urgent transfer among destinations that ``can_send`` it now; None if there is none."""
        best: Transfer | None = None
        for transfer in self.heads():
            if (best is None or transfer < best) and can_send(transfer):
                best = transfer
        return best
