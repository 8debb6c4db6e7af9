"""Which frames have been seen: one sliding window of sequence numbers per originator, bounded in every direction."""

from __future__ import annotations

from collections import OrderedDict

#: Copies of a frame that come after this many newer ones of the same originator count as seen.
WINDOW = 4096
ORIGINATORS_MAX = 1024
FORGET_S = 60.0

_SEQUENCES = 1 << 32


class _Window:
    """Bit ``i`` of ``bits`` stands for sequence number ``newest - i``."""

    __slots__ = ("bits", "newest", "used_s")

    def __init__(self, newest: int, used_s: float) -> None:
        self.newest = newest
        self.bits = 1
        self.used_s = used_s

    def is_new(self, sequence: int) -> bool:
        """Whether it has not been asked for before; serial number arithmetic of RFC 1982."""
        ahead = (sequence - self.newest) % _SEQUENCES
        if ahead >= _SEQUENCES // 2:
            return self._is_new_behind(_SEQUENCES - ahead)
        if ahead == 0:
            return False
        self.newest = sequence
        self.bits = (self.bits << ahead | 1) & _WHOLE if ahead < WINDOW else 1
        return True

    def _is_new_behind(self, behind: int) -> bool:
        if behind >= WINDOW or self.bits >> behind & 1:
            return False
        self.bits |= 1 << behind
        return True


_WHOLE = (1 << WINDOW) - 1


class Duplicates:
    """Remembers originators in the order of their last frame; the idle and, beyond the limit, the oldest go."""

    def __init__(self, *, originators_max: int = ORIGINATORS_MAX, forget_s: float = FORGET_S) -> None:
        """``originators_max`` at least 1; an originator that was silent for ``forget_s`` seconds is forgotten."""
        self._max = originators_max
        self._forget_s = forget_s
        self._windows: OrderedDict[tuple[bytes, int], _Window] = OrderedDict()

    def __len__(self) -> int:
        return len(self._windows)

    def is_new(self, originator: bytes, epoch: int, sequence: int, *, now: float) -> bool:
        """Whether this is the first call for that frame; ``now`` in seconds does not go back."""
        windows, key = self._windows, (originator, epoch)
        while windows and next(iter(windows.values())).used_s < now - self._forget_s:
            windows.popitem(last=False)
        window = windows.get(key)
        if window is None:
            if len(windows) >= self._max:
                windows.popitem(last=False)
            windows[key] = _Window(sequence, now)
            return True
        window.used_s = now
        windows.move_to_end(key)
        return window.is_new(sequence)
