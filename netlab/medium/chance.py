"""Random numbers of one pair: yes or no with a ratio and netem's correlation, and a stable seed. Pure."""

from __future__ import annotations

import hashlib
import random


def stable_seed(*parts: object) -> int:
    """Return a 128-bit seed that depends on ``parts`` alone: not on the process, the platform or the order of calls."""
    return int.from_bytes(hashlib.blake2b(repr(parts).encode(), digest_size=16).digest(), "little")


class Chance:
    """Says yes to ``ratio`` of the questions; with correlation, the way netem's ``get_crandom`` does.

    Theory (get_crandom in net/sched/sch_netem.c): the number compared with the ratio is a moving average, next =
    (1 - correlation) x fresh + correlation x last. It crowds around 1/2, so a correlated ratio below 1/2 comes out
    smaller than asked for: tc-netem(8) warns of it, and this class agrees with the kernel. Use Gilbert-Elliott for
    bursts whose ratio holds.
    """

    __slots__ = ("_correlation", "_last", "_random", "ratio")

    def __init__(self, rng: random.Random, ratio: float, correlation: float, before: Chance | None = None) -> None:
        """``before``: the one that this replaces; its last number goes on, so that a change is no restart."""
        self.ratio = ratio
        self._correlation = correlation
        self._random = rng.random
        self._last: float | None = before._last if before is not None else None

    def hit(self) -> bool:
        """Draw once. A ratio of 0 draws nothing, as in the kernel."""
        if not self.ratio:
            return False
        value = self._random()
        if self._correlation:
            last = self._random() if self._last is None else self._last
            value = self._last = value * (1 - self._correlation) + last * self._correlation
        return value < self.ratio
