"""How many frames a link loses, by the gaps in its sequence numbers, and which of the last ones arrived."""

from __future__ import annotations

_MODULUS = 1 << 16
_HALF = _MODULUS // 2
_LONGEST_GAP = 1024
WINDOW_BITS = 32
_PRIOR_FRAMES = 8
"""An interval with so few frames counts as much as all that was known before."""


class SequenceWindow:
    """The sequence numbers of one sender, modulo 2^16: the newest, and which of the 32 before it arrived."""

    __slots__ = ("bits", "newest")

    def __init__(self) -> None:
        self.newest: int | None = None
        self.bits = 0

    def take(self, sequence: int) -> int:
        """Note a number; return how many it is ahead of the newest before it.

        1 is the next in turn, more a gap of lost (or late) ones; 0 fills a gap; -1 was there already. A number too far
        away begins anew, as after the sender's restart, and counts as the next in turn.
        """
        if self.newest is None:
            self.newest, self.bits = sequence, 0
            return 1
        ahead = (sequence - self.newest) % _MODULUS
        if 0 < ahead <= _LONGEST_GAP:
            self.bits = (self.bits << ahead | 1 << ahead - 1) & (1 << WINDOW_BITS) - 1
            self.newest = sequence
            return ahead
        behind = _MODULUS - ahead if ahead else 0
        if behind == 0:
            return -1
        if behind > _LONGEST_GAP:
            self.newest, self.bits = sequence, 0
            return 1
        if behind > WINDOW_BITS:
            return -1
        bit = 1 << behind - 1
        if self.bits & bit:
            return -1
        self.bits |= bit
        return 0


class LossEstimate:
    """The loss ratio of one direction of a link."""

    __slots__ = ("_expected", "_received", "ratio")

    def __init__(self) -> None:
        self.ratio = 0.0
        self._expected = 0
        self._received = 0

    def count(self, ahead: int) -> None:
        """Count a received frame that :meth:`SequenceWindow.take` found so far ahead, 0 or more."""
        self._received += 1
        self._expected += ahead

    def close_interval(self) -> None:
        """Make a new ratio of what was counted since the last call; of nothing, an older one aged.

        Source: WNet (ROBOCOMM 2007), equation 3: ``LR_i = (1 + LR_(i-1)) / 2`` where nothing was received.
        """
        if self._received == 0:
            self.ratio = (1.0 + self.ratio) / 2.0
        else:
            share = min(max(1.0 - self._received / max(self._expected, 1), 0.0), 1.0)
            self.ratio += (share - self.ratio) * self._expected / (self._expected + _PRIOR_FRAMES)
        self._expected = self._received = 0
