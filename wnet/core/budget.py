"""The share of the channel's time that one node's HELLOs and TCs may take: a token bucket in seconds of airtime."""

from __future__ import annotations

_BURST_S = 15.0
"""A node that was quiet may spend at once what it saved in this time."""


class Budget:
    """``share``: of the whole team; each of its nodes takes an equal part."""

    def __init__(self, share: float, *, now: float) -> None:
        self._share = share
        self._part = share
        self._saved_s = share * _BURST_S
        self._at = now

    def divide(self, nodes: int) -> None:
        """Tell how many nodes share the channel."""
        self._part = self._share / max(nodes, 1)
        self._saved_s = min(self._saved_s, self._part * _BURST_S)

    def spend(self, airtime_s: float, *, now: float) -> None:
        """Account for a frame, whether it was affordable or not (others' TCs have to be relayed)."""
        self._refill(now)
        self._saved_s = max(self._saved_s - airtime_s, -self._part * _BURST_S)

    def wait_s(self, airtime_s: float, *, now: float, reserve_s: float = 0.0) -> float:
        """Return how long to wait until a frame is affordable, 0 if it is now.

        Args:
            airtime_s: Of the frame.
            now: Monotonic seconds.
            reserve_s: What is saved in so much time is left for other frames; below 0, so much of a debt is allowed.
        """
        self._refill(now)
        return max(airtime_s + reserve_s * self._part - self._saved_s, 0.0) / self._part

    @property
    def debt_wait_s(self) -> float:
        """How long a debt takes to be paid; 0 if there is none."""
        return max(-self._saved_s, 0.0) / self._part

    def _refill(self, now: float) -> None:
        elapsed_s = max(now - self._at, 0.0)
        self._at = now
        self._saved_s = min(self._saved_s + elapsed_s * self._part, self._part * _BURST_S)
