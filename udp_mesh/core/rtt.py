"""Round-trip time of one path: smoothed, varied, least."""

from __future__ import annotations

INITIAL_RTT_S = 0.1
GRANULARITY_S = 0.005  # a busy host answers no more punctually; less would repeat what was not lost
MAX_PROBE_TIMEOUT_S = 0.1


class RttEstimator:
    """Source: RFC 6298 section 2, with the constants of RFC 9002 section 5."""

    __slots__ = ("has_sample", "latest_s", "min_s", "rttvar_s", "srtt_s")

    def __init__(self) -> None:
        self.has_sample = False
        self.srtt_s = INITIAL_RTT_S
        self.rttvar_s = INITIAL_RTT_S / 2
        self.latest_s = INITIAL_RTT_S
        self.min_s = INITIAL_RTT_S

    def update(self, sample_s: float, *, ack_delay_s: float) -> None:
        """Take one sample; ``ack_delay_s`` is how long the receiver kept the acknowledgement."""
        if sample_s <= 0:
            return
        self.min_s = min(self.min_s, sample_s) if self.has_sample else sample_s
        adjusted_s = sample_s - ack_delay_s if sample_s - ack_delay_s >= self.min_s else sample_s
        self.latest_s = adjusted_s
        if not self.has_sample:
            self.has_sample = True
            self.srtt_s, self.rttvar_s = adjusted_s, adjusted_s / 2
            return
        self.rttvar_s += 0.25 * (abs(self.srtt_s - adjusted_s) - self.rttvar_s)
        self.srtt_s += 0.125 * (adjusted_s - self.srtt_s)

    def probe_timeout_s(self, *, expirations: int) -> float:
        """Return how long to wait for an acknowledgement before sending more to provoke one.

        It doubles with every expiration in a row, but stays at 100 ms on paths fast enough for it: on a lossy radio a
        long back-off only lengthens the gap. On slower paths it is never below srtt + 4 rttvar.
        """
        base_s = self.srtt_s + max(4 * self.rttvar_s, GRANULARITY_S)
        backed_off_s: float = base_s * (1 << min(expirations, 3))
        return min(backed_off_s, max(base_s, MAX_PROBE_TIMEOUT_S))
