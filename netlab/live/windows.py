"""Latencies of the last minute in buckets of time, for sparklines and percentiles. Pure."""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import log

_KEPT_PER_BUCKET = 256


@dataclass(slots=True)
class _Bucket:
    number: int
    sorted_s: list[float] = field(default_factory=list)


@dataclass(slots=True)
class LatencyWindow:
    """Latencies by the time of their delivery, in buckets of ``bucket_s`` over the last ``buckets`` of them."""

    bucket_s: float = 1.0
    buckets: int = 60
    delivered: int = 0
    size_bytes: int = 0
    _kept: deque[_Bucket] = field(default_factory=deque)

    def add(self, latency_s: float, *, now_s: float, size_bytes: int = 0) -> None:
        """Take note of a delivery at ``now_s``."""
        self.delivered += 1
        self.size_bytes += size_bytes
        number = int(now_s // self.bucket_s)
        if not self._kept or self._kept[-1].number < number:
            self._kept.append(_Bucket(number))
        bucket = self._kept[-1]  # a record that comes a little late counts with its neighbours
        if len(bucket.sorted_s) < _KEPT_PER_BUCKET:
            insort(bucket.sorted_s, latency_s)
        while self._kept[0].number <= self._kept[-1].number - self.buckets:
            self._kept.popleft()

    def percentile_s(self, percent: float, *, now_s: float, within_s: float = 10.0) -> float | None:
        """The latency that ``percent`` % of the last deliveries did not exceed (nearest rank); None without any."""
        first = int((now_s - within_s) // self.bucket_s) + 1
        recent = sorted(value for bucket in self._kept if bucket.number >= first for value in bucket.sorted_s)
        return recent[max(0, -(-len(recent) * int(percent) // 100) - 1)] if recent else None

    def series_s(self, count: int, *, now_s: float) -> list[float | None]:
        """The median of each of the last ``count`` buckets, oldest first; None where nothing was delivered."""
        last = int(now_s // self.bucket_s)
        medians = {
            bucket.number: bucket.sorted_s[len(bucket.sorted_s) // 2] for bucket in self._kept if bucket.sorted_s
        }
        return [medians.get(number) for number in range(last - count + 1, last + 1)]


_BARS = "▁▂▃▄▅▆▇█"


def sparkline(values: Sequence[float | None], *, low: float = 1e-3, high: float = 1.0) -> str:
    """Draw values on a logarithmic scale from ``low`` to ``high``; ``·`` where there is none."""
    span = log(high / low)

    def bar(value: float) -> str:
        share = log(max(value, low) / low) / span
        return _BARS[min(len(_BARS) - 1, max(0, int(share * len(_BARS))))]

    return "".join("·" if value is None else bar(value) for value in values)
