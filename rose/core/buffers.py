"""What services do with data that comes irregularly, late or not at all. Pure; a service asks with its own clock.

Source: WNet and RoSe (ROBOCOMM 2007), section IV: services "can cope with fluctuating arrival times of data packets and
incomplete information"; "a simple solution to counter fluctuating arrival times can be to buffer data".
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

from rose.core.addressing import ServiceId
from rose.core.reception import Sample

_Value = TypeVar("_Value")


class JitterBuffer:
    """Gives samples of one sender out in the order of publication, each the same time after its publication.

    The clocks of sender and receiver need not agree: the quickest sample so far is the reference. What comes later than
    ``delay_s`` behind it has missed its turn, and is counted in ``too_late`` and dropped.
    """

    def __init__(self, delay_s: float, *, samples_max: int = 1024) -> None:
        """``delay_s`` above 0: how much slower than the quickest sample one may be; that much later all come out."""
        if delay_s <= 0:
            raise ValueError("a jitter buffer needs a delay above 0 s")
        self.delay_s = delay_s
        self.too_late = 0
        self.overflowed = 0
        self._samples_max = samples_max
        self._waiting: list[tuple[float, int, Sample]] = []
        self._last_out = -1

    def put(self, sample: Sample, *, now: float) -> None:
        """Take a sample at the moment of its receipt."""
        if sample.is_restart:
            self._last_out = -1
        slack_s = self.delay_s - sample.delay_variation_s
        if slack_s < 0 or sample.sequence <= self._last_out:
            self.too_late += 1
            return
        heapq.heappush(self._waiting, (now + slack_s, sample.sequence, sample))
        if len(self._waiting) > self._samples_max:
            heapq.heappop(self._waiting)
            self.overflowed += 1

    def take(self, *, now: float) -> list[Sample]:
        """Return the samples whose time has come."""
        out = []
        while self._waiting and self._waiting[0][0] <= now:
            _due, sequence, sample = heapq.heappop(self._waiting)
            if sequence > self._last_out or sample.is_restart:
                out.append(sample)
                self._last_out = sequence
            else:
                self.too_late += 1
        return out

    def next_due(self) -> float | None:
        """When :meth:`take` next has something; None while it is empty."""
        return self._waiting[0][0] if self._waiting else None


class LatestValues(Generic[_Value]):
    """The newest value of every sender, as long as it is fresh enough."""

    def __init__(self, *, fresh_s: float) -> None:
        """``fresh_s``: how many seconds a value is good for."""
        self._fresh_s = fresh_s
        self._values: dict[ServiceId, tuple[float, _Value]] = {}

    def put(self, sender: ServiceId, value: _Value, *, now: float) -> None:
        """Replace a sender's value."""
        self._values[sender] = (now, value)

    def get(self, sender: ServiceId, *, now: float) -> _Value | None:
        """Return a sender's value; None if there is none that is fresh."""
        at, value = self._values.get(sender, (float("-inf"), None))
        return value if now - at <= self._fresh_s else None

    def fresh(self, *, now: float) -> dict[ServiceId, _Value]:
        """Return all fresh values; the others are forgotten."""
        self._values = {sid: entry for sid, entry in self._values.items() if now - entry[0] <= self._fresh_s}
        return {sender: value for sender, (_at, value) in self._values.items()}


class Freshness(Enum):
    """What :class:`Deadline` says: nothing came yet, all is well, or it has been silent for too long."""

    NEVER_SEEN = "never_seen"
    FRESH = "fresh"
    STALE = "stale"


@dataclass(slots=True)
class Deadline:
    """Says when data has become too old to act upon, so that a robot can stop rather than drive blindly."""

    limit_s: float
    seen_at: float | None = None

    def seen(self, *, now: float) -> None:
        """Note that data came."""
        self.seen_at = now

    def state(self, *, now: float) -> Freshness:
        """Say how it stands."""
        if self.seen_at is None:
            return Freshness.NEVER_SEEN
        return Freshness.FRESH if now - self.seen_at <= self.limit_s else Freshness.STALE

    def next_due(self) -> float | None:
        """When data becomes stale unless more comes."""
        return None if self.seen_at is None else self.seen_at + self.limit_s
