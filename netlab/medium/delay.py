"""The varying part of a frame's delay. Pure.

Theory. A uniform position picks from the distribution's inverse, scaled by the jitter (tabledist in sch_netem.c).
Correlation deviates from netem on purpose: the kernel reduces its moving average modulo the table's size or twice the
jitter, which leaves next to no correlation (and, unreduced, would squeeze the distribution towards its mean). Here a
Gaussian AR(1) process z' = c z + sqrt(1 - c^2) n is mapped to the position by its own distribution function, so the
delays keep the asked-for distribution *and* successive ones correlate by about ``delay_correlation``.
"""

from __future__ import annotations

import math
import random

from netlab.medium.distributions import SCALE, delay_values
from netlab.medium.impairments import Distribution, Impairment

_SQRT2 = math.sqrt(2)


class Jitter:
    """Draws delays around ``delay_s``; never below 0."""

    __slots__ = ("_correlation", "_delay_s", "_jitter_s", "_rng", "_table", "_z")

    def __init__(self, impairment: Impairment, rng: random.Random, before: Jitter | None = None) -> None:
        """``before``: the one that this replaces, whose correlated state goes on."""
        self._rng = rng
        self._delay_s = impairment.delay_s
        self._jitter_s = impairment.jitter_s
        self._correlation = impairment.delay_correlation
        uniform = impairment.distribution is Distribution.UNIFORM
        self._table = None if uniform else delay_values(impairment.distribution)
        self._z: float | None = before._z if before is not None else None

    def draw_s(self) -> float:
        """Return one delay in seconds, >= 0."""
        position = self._correlated() if self._correlation else self._rng.random()
        table = self._table
        offset = 2 * position - 1 if table is None else table[int(position * len(table))] / SCALE
        return max(0.0, self._delay_s + self._jitter_s * offset)

    def _correlated(self) -> float:
        fresh = self._rng.gauss(0, 1)
        c = self._correlation
        self._z = fresh if self._z is None else c * self._z + math.sqrt(1 - c * c) * fresh
        return min(0.5 * math.erfc(-self._z / _SQRT2), 1 - 2**-53)
