"""Calls at virtual times, for the fake networks of udp_mesh and wnet."""

from __future__ import annotations

import heapq
from collections.abc import Callable


class VirtualCalls:
    """A clock that stands at ``now`` until its owner moves it, and what is to be called then; at one time in order."""

    def __init__(self, now: float) -> None:
        self.now = now
        self._calls: list[tuple[float, int, Callable[[], None]]] = []
        self._order = 0

    def at(self, when_s: float, call: Callable[[], None]) -> None:
        """Call something at a virtual time."""
        self._order += 1
        heapq.heappush(self._calls, (when_s, self._order, call))

    def every(self, interval_s: float, call: Callable[[], None], *, until_s: float) -> None:
        """Call something regularly from now on."""

        def again() -> None:
            call()
            if self.now + interval_s < until_s:
                self.at(self.now + interval_s, again)

        self.at(self.now, again)

    def _call_due(self) -> bool:
        """Call what is due; whether anything was."""
        called = False
        while self._calls and self._calls[0][0] <= self.now:
            heapq.heappop(self._calls)[2]()
            called = True
        return called
