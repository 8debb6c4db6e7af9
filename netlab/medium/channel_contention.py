"""Who may transmit when: carrier sense, DIFS and slotted back-off of the stations on one channel. Pure.

Theory of operation (IEEE 802.11-2016, 10.3.4). A station with a frame draws a number of slots. They run while it has
heard nothing for DIFS, stand still while it hears somebody, and go on a DIFS after that; at 0 it transmits. What a
station hears is counted, not owned: several transmissions may overlap.

* A station notices another one's carrier ``SENSE_S`` late: who starts within that of another collides with it.
* Every frame draws, also on an idle channel, where 802.11 lets it go at once. Real stacks keep two robots that publish
  at the same instant some microseconds apart; exact virtual time would have them collide every time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

#: aCCATime of a 20 MHz channel is below 4 us (IEEE 802.11-2016, table 17-21).
SENSE_S = 4e-6
_NEVER = math.inf
_NOTHING = -1
_ROUNDING = 1e-3  # of a slot: what adding seconds of any origin may lose


class Contention:
    """The stations 0..count-1. ``starts_s[i]`` is when station i transmits if it hears nobody until then."""

    __slots__ = ("_busy", "_counts_from_s", "_difs_s", "_idle_since_s", "_slot_s", "_slots", "starts_s")

    def __init__(self, count: int, *, difs_s: float, slot_s: float) -> None:
        self._difs_s = difs_s
        self._slot_s = slot_s
        self.starts_s = [_NEVER] * count
        self._slots = [_NOTHING] * count  # left to wait for; _NOTHING without a frame
        self._counts_from_s = [0.0] * count
        self._busy = [0] * count  # transmissions heard, its own included
        self._idle_since_s = [-_NEVER] * count

    def want(self, station: int, slots: int, *, now: float) -> None:
        """A station has a frame to send after ``slots``."""
        self._slots[station] = slots
        if not self._busy[station]:
            from_s = max(now, self._idle_since_s[station] + self._difs_s)
            self._counts_from_s[station] = from_s
            self.starts_s[station] = from_s + slots * self._slot_s

    def started(self, station: int) -> None:
        """A station transmits: its slots are used up."""
        self._slots[station] = _NOTHING
        self.starts_s[station] = _NEVER

    def occupy(self, stations: Iterable[int], *, now: float) -> None:
        """These hear a transmission that begins; who is about to start cannot be stopped any more."""
        busy, starts_s = self._busy, self.starts_s
        too_late_s = now + SENSE_S
        for station in stations:
            if not busy[station] and too_late_s <= starts_s[station] < _NEVER:
                self._freeze(station, now)
            busy[station] += 1

    def release(self, stations: Iterable[int], *, now: float) -> None:
        """That transmission is over for these."""
        busy, slots, idle_since_s, from_s = self._busy, self._slots, self._idle_since_s, now + self._difs_s
        for station in stations:
            busy[station] -= 1
            if not busy[station]:
                idle_since_s[station] = now
                left = slots[station]
                if left != _NOTHING and self.starts_s[station] == _NEVER:
                    self._counts_from_s[station] = from_s
                    self.starts_s[station] = from_s + left * self._slot_s

    def _freeze(self, station: int, now: float) -> None:
        passed_s = now - self._counts_from_s[station]
        if passed_s > 0:
            passed = int(passed_s / self._slot_s + _ROUNDING)
            self._slots[station] = max(0, self._slots[station] - passed)
        self.starts_s[station] = _NEVER
