"""How late departures are: the most, and quantiles from counts in steps. Pure."""

from __future__ import annotations

_STEPS_PER_S = 20_000  # 50 us each
_STEPS = 20_000  # beyond a second all are the same


class Lateness:
    """Counts; ``max_s`` is the greatest so far."""

    def __init__(self) -> None:
        self.max_s = 0.0
        self._counts = [0] * (_STEPS + 1)
        self._total = 0

    def add(self, late_s: float) -> None:
        """Count one departure, ``late_s`` >= 0 after its time."""
        if late_s > self.max_s:
            self.max_s = late_s
        self._total += 1
        self._counts[min(int(late_s * _STEPS_PER_S), _STEPS)] += 1

    def quantile_s(self, share: float) -> float:
        """The least multiple of the step that ``share`` (0..1) of the departures stayed under; 0 without any."""
        wanted, seen = share * self._total, 0
        for step, count in enumerate(self._counts):
            seen += count
            if seen and seen >= wanted:
                return min(self.max_s, (step + 1) / _STEPS_PER_S)
        return 0.0
