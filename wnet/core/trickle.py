"""When what is told again and again is due: soon after a change, ever more rarely while nothing changes (RFC 6206)."""

from __future__ import annotations

import random


class Trickle:
    """One interval that doubles: ``fast_s`` after a change, at last ``slow_s``.

    ``is_urgent``: a change waits to be told; ``credit_s``: the time whose share of the channel it may owe.
    """

    def __init__(self, fast_s: float, slow_s: float, *, now: float) -> None:
        self._fast_s, self._slow_s = min(fast_s, slow_s), slow_s
        self.interval_s = self._fast_s
        self.due = now
        self.is_urgent, self.credit_s = False, 0.0
        self._sent_at = float("-inf")

    def reset(self, delay_s: float, *, spacing_s: float, credit_s: float, now: float) -> None:
        """Note a change, to be told ``delay_s`` from now, and no sooner than ``spacing_s`` after what was told last."""
        self.interval_s = self._fast_s
        self.is_urgent, self.credit_s = True, max(self.credit_s, credit_s)
        self.due = min(self.due, max(now + delay_s, self._sent_at + spacing_s))

    def sent(self, rng: random.Random, *, now: float) -> float:
        """Note that it was sent; return the time until the next, drawn from the last quarter of the interval."""
        self._sent_at = now
        self.is_urgent, self.credit_s = False, 0.0
        wait_s = self.interval_s * (1.0 - 0.25 * rng.random())
        self.due = now + wait_s
        self.interval_s = min(2.0 * self.interval_s, self._slow_s)
        return wait_s
