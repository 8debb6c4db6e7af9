"""Fragments that leave once more a little later, unless their arrival is known by then.

Two kinds of copies, both at their message's own priority: a topic's ``redundancy``, and a second try of each
retransmission of a small message. On a radio that loses 15 % of everything, one retransmission in seven is lost as
well, and each loss costs a whole round trip more. Copies are spread, because losses come in bursts.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from udp_mesh.core.messages import Transfer

SPREAD_S = 0.002


class Copies:
    """What is to leave once more, by time."""

    def __init__(self) -> None:
        self._planned: list[tuple[float, int, Transfer, int]] = []
        self._order = 0

    def note_sent(self, transfer: Transfer, index: int, *, now: float) -> None:
        """Plan the next copy of a fragment that leaves now, if it wants one."""
        if transfer.take_copy(index):
            self._order += 1
            heapq.heappush(self._planned, (now + SPREAD_S, self._order, transfer, index))

    def due(self, *, now: float) -> Iterator[Transfer]:
        """Yield transfers of which a copy waits to be sent from now on."""
        while self._planned and self._planned[0][0] <= now:
            _due_s, _order, transfer, index = heapq.heappop(self._planned)
            if not transfer.is_done and transfer.send_copy(index):
                yield transfer

    def next_timer(self) -> float | None:
        """Return when the next copy is due."""
        return self._planned[0][0] if self._planned else None
