"""Congestion control on queueing delay: about a packet waits at the bottleneck, whatever its rate.

Theory of operation, after FAST TCP (Wei, Jin, Low and Hegde, IEEE/ACM Transactions on Networking 14(6), 2006, eq. 6):
once per round trip the window moves by ``GAIN`` times the difference between the bytes that should wait at the
bottleneck and those that do, which are window * queueing delay / round trip. Every flow keeps equally many packets
waiting there, so flows share fairly. What differs from the paper:

* Delay is one-way, on the forward path (the receiver stamps arrivals), so a busy return path does not slow us. It is
  compared among full packets only, as long as there are any: small ones take less time to serialise.
* The queueing delay of a round is the least that was seen in it. A delay that hits everything at once (a node that
  stands still) ends within the round and is no queue.
* On fast links a packet is too small a unit: there ``UNIT_S`` worth of the rate waits.
* While no queue is seen for several rounds the steps double, up to ``MAX_GROWTH`` of the window: a link that got
  faster is found.
* Our own standing queue would pass for the path's base delay once every older sample is forgotten. And a radio that
  falls to a lower rate takes longer for each packet, which looks like a queue but is none. So every
  ``DRAIN_INTERVAL_S``, or after ``BUSY_ROUNDS`` with a queue that will not go, one round keeps so much less in flight
  that the queue runs empty, and the least delay seen then is the base from there on.
* A round trip that is little more than one packet's own time is a radio's: data and acknowledgements take turns there.
  They are asked for every ``ACK_SPACING_S`` only, and round trip and window count that in. Not while a faster link is
  being looked for, because the window moves once per round trip.
* Where the carrier's rate is known beforehand, the window begins with that rate times ``INITIAL_RTT_S``.
* Loss alone says nothing on a radio. Only loss of more than ``HEAVY_LOSS_RATIO`` over whole windows shrinks the window.
* Packets leave at ``PACING_GAIN`` times window per round trip. A few urgent packets may exceed window and pace.
"""

from __future__ import annotations

import math
from collections import deque

from udp_mesh.core.congestion import AckSample
from udp_mesh.core.pacer import QUANTUM_S
from udp_mesh.core.rtt import INITIAL_RTT_S, RttEstimator
from udp_mesh.core.windowed import WindowedMinimum

TARGET_PACKETS = 0.5
UNIT_S = 0.0005
GAIN = 0.5
PACING_GAIN = 1.05
START_GROWTH = 1.5
START_GAIN = START_GROWTH * math.log(START_GROWTH) / (START_GROWTH - 1)  # so it grows in an even stream, not in bursts
MAX_GROWTH = 0.125
CALM_ROUNDS = 3
BASE_WINDOW_S = 10.0
DRAIN_INTERVAL_S = 1.0
DRAIN_ROUNDS = 10
BUSY_ROUNDS = 4
FULL_SHARE = 0.9
MAX_AIRTIME_S = 0.008
ACK_SPACING_S = 0.01
SHORT_PATH_PACKETS = 3
MIN_DATAGRAM_BYTES = 256  # less would be half headers
FRAME_HEADER_BYTES = 42  # Ethernet, IPv4, UDP
DATAGRAM_STEP = 64
MIN_PACKETS = 2
INITIAL_PACKETS = 8
MAX_CWND_BYTES = 64 * 1024 * 1024
URGENT_PACKETS = 4
HEAVY_LOSS_RATIO = 0.35
HEAVY_LOSS_BACKOFF = 0.8
HEAVY_LOSS_SAMPLE = 20
_STANDING_SAMPLES = 3
_RATE_SAMPLES = 8


class DelayControl:
    """One flow's window."""

    urgent_packets = URGENT_PACKETS

    def __init__(self, *, datagram_bytes: int, rate_bps: float = 0.0, shared_bps: float = 0.0, now: float) -> None:
        """Begin with an unknown path.

        Args:
            datagram_bytes: The largest datagram that the path takes.
            rate_bps: What it is said to carry, 0 if nobody knows.
            shared_bps: Rate of the channel of which this path gets a part, 0 for a link of its own: a packet then takes
                no longer than at this rate, however little the part is, and others may begin at the same moment.
            now: Seconds.
        """
        self._shared_bps = shared_bps
        self.datagram_bytes = self._most_datagram_bytes = datagram_bytes
        self.rate_bps = rate_bps
        self.queue_delay_s = 0.0
        hint_bytes = max(rate_bps / 8 * INITIAL_RTT_S, MIN_PACKETS * datagram_bytes)
        first_packets = MIN_PACKETS if shared_bps else INITIAL_PACKETS
        self._cwnd = hint_bytes if rate_bps else float(first_packets * datagram_bytes)
        self._held_back_bytes = 0.0  # of the window, while the queue is drained
        self._rtt_s = 0.0  # without what acknowledgements wait for each other
        self._ack_spacing_s = 0.0
        self._base = WindowedMinimum()
        self._small_base = WindowedMinimum()
        self._rtt_base = WindowedMinimum()
        self._full_at_s = float("-inf")
        self._standing: deque[float] = deque(maxlen=_STANDING_SAMPLES)
        self._arrivals: deque[tuple[int, int]] = deque(maxlen=_RATE_SAMPLES)  # (received_us, bytes acknowledged)
        self._acked_bytes = 0
        self._in_slow_start = True
        self._queue_seen = False
        self._velocity = 1.0
        self._calm_rounds = 0
        self._busy_rounds = 0
        self._drain_at_s = now
        self._drained_s: tuple[float, float] | None = None  # least one-way delay and round trip while draining
        self._skips_rounds = 0
        self._acked_packets = 0
        self._lost_packets = 0
        self._round_ends_s = now
        self._round_delay_s = float("inf")
        self._round_bytes = 0
        self._round_flight_bytes = 0
        self._limited_bytes = 0

    @property
    def cwnd_bytes(self) -> int:
        """Bytes that may be in flight."""
        return int(max(self._cwnd - self._held_back_bytes, self.datagram_bytes))

    @property
    def ack_spacing_bytes(self) -> float:
        """Bytes after which an acknowledgement is worth its airtime; 0: with every second packet."""
        return self._ack_spacing_s * self.rate_bps / 8

    @property
    def capacity_bps(self) -> float:
        """Estimated rate of the path; 0 before it was ever full."""
        return 0.0 if self._in_slow_start else self.rate_bps

    @property
    def pacing_rate_bps(self) -> float | None:
        """Window per round trip times a gain; None before the first round trip is known."""
        if self._rtt_s <= 0:
            return None
        return (
            (START_GAIN if self._in_slow_start and not self._queue_seen else PACING_GAIN) * 8 * self._cwnd / self._rtt_s
        )

    def on_ack(self, sample: AckSample, *, rtt: RttEstimator, now: float) -> None:
        """Take one acknowledgement; once per round trip the window moves."""
        self._acked_packets += sample.acked_packets
        self._lost_packets += sample.lost_packets
        self._acked_bytes += sample.acked_bytes
        self._round_bytes += sample.acked_bytes
        self._round_flight_bytes = max(self._round_flight_bytes, sample.in_flight_bytes + sample.acked_bytes)
        if sample.is_limited:
            self._limited_bytes += sample.acked_bytes
        if sample.rate_bps:
            gain = 0.125 if sample.is_limited or sample.rate_bps > self.rate_bps else 0.0
            self.rate_bps += gain * (sample.rate_bps - self.rate_bps)
        if sample.one_way_s is not None:
            self._measure(sample, sample.one_way_s, rtt=rtt, now=now)
        if self._rtt_s <= 0 or not sample.acked_bytes:
            return
        if self._in_slow_start:
            self._slow_start(sample)
        if now >= self._round_ends_s:
            self._end_round(now=now)
        self._clamp()

    def _measure(self, sample: AckSample, one_way_s: float, *, rtt: RttEstimator, now: float) -> None:
        is_full = sample.newest_bytes >= FULL_SHARE * self.datagram_bytes
        base_s = (self._base if is_full else self._small_base).update(one_way_s, window_s=BASE_WINDOW_S, now=now)
        rtt_base_s = self._rtt_base.update(rtt.latest_s, window_s=BASE_WINDOW_S, now=now)
        self._arrivals.append((sample.received_us, self._acked_bytes))
        if is_full:
            self._full_at_s = now
            if self._drained_s is not None:
                self._drained_s = (min(self._drained_s[0], one_way_s), min(self._drained_s[1], rtt.latest_s))
        elif now - self._full_at_s < DRAIN_INTERVAL_S:
            return
        self._standing.append(one_way_s - base_s)
        self._round_delay_s = min(self._round_delay_s, one_way_s - base_s)
        self.queue_delay_s = min(self._standing)
        self._rtt_s = rtt_base_s + self.queue_delay_s + self._ack_spacing_s

    def _slow_start(self, sample: AckSample) -> None:
        """Grow by half per round trip until a queue shows; then go to what the bottleneck delivers while it has one."""
        if not self._queue_seen:
            if self.queue_delay_s <= self._start_target_s():
                if sample.is_limited:
                    self._cwnd += (START_GROWTH - 1) * sample.acked_bytes
                return
            self._queue_seen = True
            self._arrivals.clear()
            self._cwnd /= START_GROWTH  # what was in flight when the packet left that now shows a queue
        elif len(self._arrivals) == _RATE_SAMPLES:
            (first_us, first_bytes), (last_us, last_bytes) = self._arrivals[0], self._arrivals[-1]
            elapsed_s = ((last_us - first_us) & 0xFFFFFFFF) / 1e6
            if elapsed_s > 0:
                self.rate_bps = 8 * (last_bytes - first_bytes) / elapsed_s
                bandwidth_delay = self.rate_bps / 8 * (self._rtt_s - self.queue_delay_s)
                self._cwnd = min(START_GROWTH * self._cwnd, bandwidth_delay + self._target_bytes())
            self._in_slow_start = self._queue_seen = False
            self._skips_rounds = 2  # what is in flight still shows the overshoot

    def _start_target_s(self) -> float:
        return 2 * self._target_bytes() * self._rtt_s / self._cwnd

    def _target_bytes(self) -> float:
        """Return what should wait at the bottleneck."""
        return max(TARGET_PACKETS * self.datagram_bytes, UNIT_S * self._cwnd / self._rtt_s)

    def _begin_round(self, *, now: float) -> None:
        self._round_ends_s = now + self._rtt_s
        self._round_delay_s = float("inf")
        self._round_bytes = 0
        self._round_flight_bytes = 0
        self._limited_bytes = 0

    def _end_round(self, *, now: float) -> None:
        self._check_loss()
        delay_s = self._round_delay_s
        is_limited = 2 * self._limited_bytes >= self._round_bytes
        self._held_back_bytes = 0.0
        if self._skips_rounds:
            self._skips_rounds -= 1
            if not self._skips_rounds:
                self._end_drain(now=now)
        elif not self._in_slow_start and delay_s < float("inf"):
            self._move(delay_s, is_limited=is_limited)
            self._drain(delay_s, now=now)
        self._fit_datagram()
        self._space_acks()
        self._begin_round(now=now)

    def _fit_datagram(self) -> None:
        """Shrink fragments on a slow path, so that an urgent one need not wait long for one under way."""
        if self.capacity_bps > 0:
            packet_bps = max(self.capacity_bps, self._shared_bps)
            fitting = int(packet_bps / 8 * MAX_AIRTIME_S - FRAME_HEADER_BYTES) // DATAGRAM_STEP * DATAGRAM_STEP
            self.datagram_bytes = min(max(fitting, MIN_DATAGRAM_BYTES), self._most_datagram_bytes)

    def _space_acks(self) -> None:
        """Ask for fewer acknowledgements where they cost airtime; the window grows by what meanwhile waits for one."""
        if self._skips_rounds or not self.capacity_bps:
            return
        packet_s = 8 * self.datagram_bytes / self.capacity_bps
        path_s = self._rtt_s - self._ack_spacing_s - self.queue_delay_s
        is_short = packet_s >= QUANTUM_S and path_s <= SHORT_PATH_PACKETS * packet_s
        spacing_s = ACK_SPACING_S if is_short and self._calm_rounds <= CALM_ROUNDS else 0.0
        change_s = spacing_s - self._ack_spacing_s
        self._cwnd += change_s * self.capacity_bps / 8
        self._rtt_s += change_s
        self._ack_spacing_s = spacing_s

    def _move(self, delay_s: float, *, is_limited: bool) -> None:
        waiting = self._cwnd * delay_s / (self._rtt_s - self.queue_delay_s + delay_s)
        target = self._target_bytes()
        if waiting > target / 2:
            self._calm_rounds, self._velocity = 0, 1.0
        self._busy_rounds = self._busy_rounds + 1 if waiting > 2 * target else 0
        if waiting < target and not is_limited:
            return
        if waiting <= target / 2:
            self._calm_rounds += 1
            if self._calm_rounds > CALM_ROUNDS:
                self._velocity *= 2
        step = GAIN * (target - waiting) * self._velocity
        most = max(MAX_GROWTH * self._cwnd, self.datagram_bytes)
        if step >= most:
            step, self._velocity = most, self._velocity / 2
        self._cwnd += max(step, -self._cwnd / 2)

    def _drain(self, delay_s: float, *, now: float) -> None:
        if now < self._drain_at_s and self._busy_rounds < BUSY_ROUNDS:
            return
        self._busy_rounds = 0
        self._drained_s = (float("inf"), float("inf"))
        self._drain_at_s = now + max(DRAIN_INTERVAL_S, DRAIN_ROUNDS * self._rtt_s)
        unused = max(0.0, self._cwnd - self._round_flight_bytes)
        self._held_back_bytes = unused + self._cwnd * delay_s / self._rtt_s + self.datagram_bytes
        self._skips_rounds = 2

    def _end_drain(self, *, now: float) -> None:
        if self._drained_s is not None and self._drained_s[0] < float("inf"):
            self._base.raise_to(self._drained_s[0], now=now)
            self._rtt_base.raise_to(self._drained_s[1], now=now)
        self._drained_s = None

    def _check_loss(self) -> None:
        total = self._acked_packets + self._lost_packets
        if total < HEAVY_LOSS_SAMPLE:
            return
        if self._lost_packets > HEAVY_LOSS_RATIO * total:
            self._in_slow_start = False
            self._cwnd *= HEAVY_LOSS_BACKOFF
        self._acked_packets = self._lost_packets = 0

    def _clamp(self) -> None:
        self._cwnd = min(max(self._cwnd, MIN_PACKETS * self.datagram_bytes), MAX_CWND_BYTES)

    def on_return(self, *, now: float) -> None:
        """Measure delays afresh; keep window and rate."""
        for samples in (self._base, self._small_base, self._rtt_base, self._standing, self._arrivals):
            samples.clear()
        self.queue_delay_s = self._held_back_bytes = 0.0
        self._velocity, self._calm_rounds, self._busy_rounds = 1.0, 0, 0
        self._drained_s = None
        self._acked_packets = self._lost_packets = 0
        self._begin_round(now=now)
