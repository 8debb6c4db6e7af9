"""Spreads packets over time."""

from __future__ import annotations

BURST_S = 0.001
QUANTUM_S = 0.0005


class Pacer:
    """Lets packets leave at a rate; what a late turn missed is caught up within limits.

    Where a packet takes less than ``QUANTUM_S``, packets wait until that much may leave at once, and up to ``BURST_S``
    is caught up: a fast link is filled by bursts, for which one system call is enough. Where it takes longer, no two
    leave at once: the second would wait for the first at the bottleneck, and the wait pass for a queue there.
    """

    __slots__ = ("_free_at_s", "_next_at_s")

    def __init__(self) -> None:
        self._free_at_s = 0.0  # when what was sent has left at the rate
        self._next_at_s = 0.0

    @property
    def next_at_s(self) -> float:
        """When the next packets may leave."""
        return self._next_at_s

    def packets_now(self, size_bytes: int, *, rate_bps: float | None, limit: int, now: float) -> int:
        """Return how many packets of one size may leave now, at most ``limit``."""
        if self._next_at_s > now:
            return 0
        if rate_bps is None:
            return limit
        packet_s = 8 * size_bytes / rate_bps
        arrears_s = now - max(self._free_at_s, now - _most_arrears_s(packet_s))
        return min(limit, int(arrears_s / packet_s) + 1)

    def on_sent(self, size_bytes: int, *, count: int = 1, rate_bps: float | None, now: float) -> None:
        """Count ``count`` packets of one size, also if they were let through early: they delay the next."""
        if rate_bps is None:
            return
        packet_s = 8 * size_bytes / rate_bps
        self._free_at_s = max(self._free_at_s, now - _most_arrears_s(packet_s)) + count * packet_s
        self._next_at_s = self._free_at_s
        if self._free_at_s > now:
            self._next_at_s += max(0.0, QUANTUM_S - packet_s)

    def reset(self) -> None:
        """Let the next packet leave at once."""
        self._free_at_s = self._next_at_s = 0.0


def _most_arrears_s(packet_s: float) -> float:
    return BURST_S if packet_s < QUANTUM_S else packet_s / 4
