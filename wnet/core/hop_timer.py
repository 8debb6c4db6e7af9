"""The round trip over one hop: when to send again, and how much may be under way. RFC 6298 for the former.

The window keeps the queue of the driver (or of whatever is between the two nodes) short, so that frames wait in our own
queue, where urgent ones overtake: it grows while round trips stay near the least one seen, and shrinks when several in
a row are above that. A single late one is a process that had to wait for its turn, not a queue.
"""

from __future__ import annotations

FIRST_RTO_S = 0.05
_LONGEST_RTO_S = 1.0
_STANDING_DELAY_S = 0.01
"""How much longer than the least round trip frames may take before the window shrinks."""
_LATE_IN_A_ROW = 3
"""How many of them make a queue."""
_LEAST_FRAMES, _FIRST_FRAMES, _MOST_FRAMES = 4.0, 32.0, 1024.0
_MINIMUM_LIFETIME_S = 10.0


class HopTimer:
    """Round-trip times of one link and what follows from them."""

    __slots__ = ("_floor_s", "_late", "_least", "_shrunk_at", "rttvar_s", "srtt_s", "window")

    def __init__(self, rto_min_s: float) -> None:
        self._floor_s = rto_min_s
        self.srtt_s: float | None = None
        self.rttvar_s = 0.0
        self.window = _FIRST_FRAMES
        self._least: tuple[tuple[float, float], tuple[float, float]] | None = None  # (rtt, at): of both half lives
        self._late = 0
        self._shrunk_at = float("-inf")

    @property
    def rto_s(self) -> float:
        """How long to wait for an acknowledgement."""
        if self.srtt_s is None:
            return max(FIRST_RTO_S, self._floor_s)
        return min(max(self.srtt_s + 4.0 * self.rttvar_s, self._floor_s), _LONGEST_RTO_S)

    def sample(self, rtt_s: float, *, in_flight: int, now: float) -> None:
        """Take a measured round trip; ``in_flight``: frames that were under way."""
        if self.srtt_s is None:
            self.srtt_s, self.rttvar_s = rtt_s, rtt_s / 2.0
        else:
            self.rttvar_s += (abs(self.srtt_s - rtt_s) - self.rttvar_s) / 4.0
            self.srtt_s += (rtt_s - self.srtt_s) / 8.0
        if rtt_s - self._least_s(rtt_s, now) <= _STANDING_DELAY_S:
            self._late = 0
            if in_flight * 2 >= self.window:
                self.window = min(self.window + 1.0, _MOST_FRAMES)
            return
        self._late += 1
        if self._late >= _LATE_IN_A_ROW and now - self._shrunk_at >= rtt_s:
            self._shrunk_at = now
            self.window = max(self.window * 0.8, _LEAST_FRAMES)

    def _least_s(self, rtt_s: float, now: float) -> float:
        if self._least is None:
            self._least = ((rtt_s, now), (rtt_s, now))
            return rtt_s
        older, newer = self._least
        if now - newer[1] > _MINIMUM_LIFETIME_S:
            older, newer = newer, (rtt_s, now)
        newer = (min(newer[0], rtt_s), newer[1])
        self._least = (older, newer)
        return min(older[0], newer[0])
