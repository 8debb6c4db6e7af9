"""Spreads packets over time."""

from __future__ import annotations

BURST_S = 0.001


class Pacer:
    """Lets packets leave at a rate, with at most ``BURST_S`` (or one packet) of arrears caught up at once."""

    __slots__ = ("_next_at_s",)

    def __init__(self) -> None:
        self._next_at_s = 0.0

    @property
    def next_at_s(self) -> float:
        """When the next packet may leave."""
        return self._next_at_s

    def on_sent(self, size_bytes: int, *, rate_bps: float | None, now: float) -> None:
        """Count a packet, also one that was let through early: it delays the next."""
        if rate_bps is None:
            return
        self._next_at_s = max(self._next_at_s, now - BURST_S) + 8 * size_bytes / rate_bps

    def reset(self) -> None:
        """Let the next packet leave at once."""
        self._next_at_s = 0.0
