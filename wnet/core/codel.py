"""When a queue stands too long: which frames to drop so that those behind them are not late as well.

Source: RFC 8289 (CoDel), sections 5.3 to 5.6. A queue that empties within an interval is a burst, and none of it is
dropped; one whose frames wait longer than the target all the time is too much for the channel, and waiting more would
make everything late without one more arriving.
"""

from __future__ import annotations

import math

INTERVAL_S = 0.1
_REMEMBERED_INTERVALS = 16.0


class CoDel:
    """The judgement on one queue, frame by frame in the order in which they leave it."""

    __slots__ = ("_condemned_at", "_count", "_earlier_count", "_is_dropping", "_next_at", "_target_s")

    def __init__(self, target_s: float) -> None:
        """``target_s``: how long a frame may wait in a standing queue."""
        self._target_s = target_s
        self._condemned_at = math.inf
        self._is_dropping = False
        self._next_at = 0.0
        self._count = self._earlier_count = 0

    def should_drop(self, waited_s: float, *, is_last: bool, now: float) -> bool:
        """Whether to drop the frame that comes off the queue at ``now``.

        Args:
            waited_s: How long it was in the queue.
            is_last: Nothing waits behind it; such a frame is kept, as it delays no other.
            now: Monotonic seconds.
        """
        if waited_s < self._target_s or is_last:
            self._condemned_at = math.inf
            self._is_dropping = False
            return False
        if self._condemned_at == math.inf:
            self._condemned_at = now + INTERVAL_S
        if now < self._condemned_at:
            return False
        if not self._is_dropping:
            self._begin(now)
            return True
        if now < self._next_at:
            return False
        self._count += 1
        self._next_at += self._pause_s()
        return True

    def _begin(self, now: float) -> None:
        """Drop the first of a series; a queue that stood a short time ago is shortened at the pace of then."""
        dropped = self._count - self._earlier_count
        is_recent = now - self._next_at < _REMEMBERED_INTERVALS * INTERVAL_S
        self._count = self._earlier_count = dropped if dropped > 1 and is_recent else 1
        self._is_dropping = True
        self._next_at = now + self._pause_s()

    def _pause_s(self) -> float:
        return INTERVAL_S / math.sqrt(self._count)
