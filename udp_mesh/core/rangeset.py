"""A bounded set of whole numbers kept as ranges, for packet numbers and message ids that arrive nearly in order."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator


class RangeSet:
    """Numbers >= 0. Everything below :attr:`floor` counts as contained, so that memory stays bounded."""

    __slots__ = ("_ends", "_starts", "floor", "max_ranges")

    def __init__(self, *, max_ranges: int) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []  # inclusive
        self.floor = 0
        self.max_ranges = max_ranges

    def __contains__(self, number: int) -> bool:
        if number < self.floor:
            return True
        at = bisect_right(self._starts, number) - 1
        return at >= 0 and number <= self._ends[at]

    def __len__(self) -> int:
        """Number of ranges."""
        return len(self._starts)

    def __bool__(self) -> bool:
        return bool(self._starts)

    def add(self, number: int) -> bool:
        """Add a number; False when it was there. Beyond ``max_ranges`` the lowest gap counts as filled."""
        if self._ends and number == self._ends[-1] + 1 and number >= self.floor:  # in order: nearly always
            self._ends[-1] = number
            return True
        if number in self:
            return False
        at = bisect_right(self._starts, number)
        joins_left = at > 0 and self._ends[at - 1] == number - 1
        joins_right = at < len(self._starts) and self._starts[at] == number + 1
        if joins_left and joins_right:
            self._ends[at - 1] = self._ends.pop(at)
            del self._starts[at]
        elif joins_left:
            self._ends[at - 1] = number
        elif joins_right:
            self._starts[at] = number
        else:
            self._starts.insert(at, number)
            self._ends.insert(at, number)
            if len(self._starts) > self.max_ranges:
                self.raise_floor(self._starts[1])
        return True

    def add_range(self, first: int, last: int) -> None:
        """Add every number from ``first`` to ``last``."""
        if first <= self.highest or first < self.floor:
            for number in range(first, last + 1):
                self.add(number)
        elif self._ends and first == self._ends[-1] + 1:
            self._ends[-1] = last
        else:
            self._starts.append(first)
            self._ends.append(last)
            if len(self._starts) > self.max_ranges:
                self.raise_floor(self._starts[1])

    def raise_floor(self, floor: int) -> None:
        """Count every number below ``floor`` as contained and forget its details."""
        if floor <= self.floor:
            return
        self.floor = floor
        keep = 0
        while keep < len(self._ends) and self._ends[keep] < floor:
            keep += 1
        del self._starts[:keep], self._ends[:keep]
        if self._starts and self._starts[0] < floor:
            self._starts[0] = floor

    def newest(self, count: int) -> list[tuple[int, int]]:
        """Return up to ``count`` inclusive ranges, highest first."""
        pairs: Iterator[tuple[int, int]] = zip(reversed(self._starts), reversed(self._ends), strict=True)
        return [pair for pair, _ in zip(pairs, range(count), strict=False)]

    @property
    def highest(self) -> int:
        """The highest number added, -1 if there is none."""
        return self._ends[-1] if self._ends else -1
