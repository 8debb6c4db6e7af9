"""The least value of a sliding time window."""

from __future__ import annotations

from collections import deque


class WindowedMinimum:
    """Least value of the last so many seconds; amortised constant time."""

    __slots__ = ("_samples",)

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque()

    def __bool__(self) -> bool:
        """Whether there is any sample."""
        return bool(self._samples)

    def update(self, value: float, *, window_s: float, now: float) -> float:
        """Add a value; return the least of those not older than ``window_s``."""
        samples = self._samples
        while samples and samples[-1][1] >= value:
            samples.pop()
        samples.append((now, value))
        while samples[0][0] < now - window_s:
            samples.popleft()
        return samples[0][1]

    def raise_to(self, value: float, *, now: float) -> None:
        """Forget everything below ``value``, which counts as a sample of now."""
        if self._samples and self._samples[0][1] < value:
            self._samples.clear()
            self._samples.append((now, value))

    def clear(self) -> None:
        """Forget everything."""
        self._samples.clear()
