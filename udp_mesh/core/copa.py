"""Congestion control on queueing delay, after Copa (Arun and Balakrishnan, NSDI 2018, section 2).

Theory of operation. The window moves towards the rate 1 / (delta * queueing delay): a few packets queued at the
bottleneck, whatever its rate. Differences from the paper:

* Delay is one-way, on the forward path (the receiver stamps arrivals), so a busy return path does not slow us.
* Below ``QUIET_DELAY_S`` delay is no sign of a queue but of schedulers and radios; the window then grows.
* On fast links a packet is too small a unit: hosts handle bursts. There the target is a queue of ``UNIT_S / delta``.
* The base delay is the least of the last 10 s; the standing delay the least of half a round trip, or 5 ms if longer.
* Loss alone says nothing on a radio. Only loss of more than ``HEAVY_LOSS_RATIO`` over whole windows shrinks the window.
* Packets leave at ``PACING_GAIN`` times window per round trip. A few urgent packets may exceed window and pace.
"""

from __future__ import annotations

from collections import deque

from udp_mesh.core.congestion import AckSample
from udp_mesh.core.rtt import RttEstimator

DELTA = 0.5
QUIET_DELAY_S = 0.001
UNIT_S = 0.001
PACING_GAIN = 1.25
START_GAIN = 2.0
BASE_WINDOW_S = 10.0
MIN_STANDING_WINDOW_S = 0.005
MIN_PACKETS = 2
INITIAL_PACKETS = 10
MAX_CWND_BYTES = 64 * 1024 * 1024
MAX_VELOCITY = 64.0
URGENT_PACKETS = 4
HEAVY_LOSS_RATIO = 0.35
HEAVY_LOSS_BACKOFF = 0.8


class WindowedMinimum:
    """Least value of a sliding time window; amortised constant time."""

    __slots__ = ("_samples",)

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque()

    def update(self, value: float, *, window_s: float, now: float) -> float:
        """Add a value; return the least of those not older than ``window_s``."""
        samples = self._samples
        while samples and samples[-1][1] >= value:
            samples.pop()
        samples.append((now, value))
        while samples[0][0] < now - window_s:
            samples.popleft()
        return samples[0][1]

    def clear(self) -> None:
        """Forget everything."""
        self._samples.clear()


class Copa:
    """One flow's window."""

    urgent_packets = URGENT_PACKETS

    def __init__(self, *, datagram_bytes: int, now: float) -> None:
        self._datagram_bytes = datagram_bytes
        self._cwnd = float(INITIAL_PACKETS * datagram_bytes)
        self.rate_bps = 0.0
        self.queue_delay_s = 0.0
        self._rtt_s = 0.0
        self._base = WindowedMinimum()
        self._standing = WindowedMinimum()
        self._in_slow_start = True
        self._velocity = 1.0
        self._direction = 0
        self._same_direction_rounds = 0
        self._round_ends_s = now
        self._round_cwnd = self._cwnd
        self._round_acked = 0
        self._round_lost = 0

    @property
    def cwnd_bytes(self) -> int:
        """Bytes that may be in flight."""
        return int(self._cwnd)

    @property
    def pacing_rate_bps(self) -> float | None:
        """Window per round trip times a gain; None before the first round trip is known."""
        if self._rtt_s <= 0:
            return None
        return (START_GAIN if self._in_slow_start else PACING_GAIN) * 8 * self._cwnd / self._rtt_s

    def on_ack(self, sample: AckSample, *, rtt: RttEstimator, now: float) -> None:
        """Move the window by one acknowledgement."""
        self._round_acked += sample.acked_packets
        self._round_lost += sample.lost_packets
        if sample.rate_bps:
            gain = 0.125 if sample.is_limited or sample.rate_bps > self.rate_bps else 0.0
            self.rate_bps += gain * (sample.rate_bps - self.rate_bps)
        if sample.one_way_s is not None:
            self._measure(sample.one_way_s, rtt=rtt, now=now)
        if self._rtt_s <= 0 or not sample.acked_bytes:
            return
        grow = self._is_below_target()
        if self._in_slow_start and not grow:
            self._in_slow_start = False
            self._cwnd = max(self._cwnd / 2, self._delivered_per_rtt())
        if grow and not sample.is_limited:
            return
        if self._in_slow_start:
            self._cwnd += sample.acked_bytes
        else:
            step = self._velocity * sample.acked_bytes * self._datagram_bytes / (DELTA * self._cwnd)
            step = min(step, sample.acked_bytes)  # at most doubles per round trip
            self._cwnd += step if grow else -step
        self._clamp()
        if now >= self._round_ends_s:
            self._end_round(now=now)

    def _measure(self, one_way_s: float, *, rtt: RttEstimator, now: float) -> None:
        base_s = self._base.update(one_way_s, window_s=BASE_WINDOW_S, now=now)
        window_s = max(rtt.srtt_s / 2, MIN_STANDING_WINDOW_S)
        self.queue_delay_s = self._standing.update(one_way_s, window_s=window_s, now=now) - base_s
        self._rtt_s = rtt.min_s + self.queue_delay_s

    def _is_below_target(self) -> bool:
        if self.queue_delay_s <= QUIET_DELAY_S:
            return True
        return self._cwnd / self._rtt_s <= self._unit_bytes() / (DELTA * self.queue_delay_s)

    def _unit_bytes(self) -> float:
        """Return what takes the place of Copa's packet: one datagram, on fast links what leaves in ``UNIT_S``."""
        return max(self._datagram_bytes, UNIT_S * self._cwnd / self._rtt_s)

    def _delivered_per_rtt(self) -> float:
        return self.rate_bps / 8 * self._rtt_s

    def _clamp(self) -> None:
        self._cwnd = min(max(self._cwnd, MIN_PACKETS * self._datagram_bytes), MAX_CWND_BYTES)

    def _end_round(self, *, now: float) -> None:
        direction = 1 if self._cwnd > self._round_cwnd else -1
        self._same_direction_rounds = self._same_direction_rounds + 1 if direction == self._direction else 0
        if direction != self._direction:
            self._velocity = 1.0
        elif self._same_direction_rounds >= 3:
            self._velocity = min(self._velocity * 2, MAX_VELOCITY)
        self._direction = direction
        total = self._round_acked + self._round_lost
        if total >= 20:
            if self._round_lost > HEAVY_LOSS_RATIO * total:
                self._in_slow_start = False
                self._cwnd *= HEAVY_LOSS_BACKOFF
                self._clamp()
            self._round_acked = self._round_lost = 0
        self._round_cwnd = self._cwnd
        self._round_ends_s = now + self._rtt_s

    def on_return(self, *, now: float) -> None:
        """Measure delays afresh; keep window and rate."""
        self._base.clear()
        self._standing.clear()
        self.queue_delay_s = 0.0
        self._velocity = 1.0
        self._round_acked = self._round_lost = 0
