"""Loss recovery of one peer's epoch: which packets are in flight, arrived, or lost, and when to probe.

Source: RFC 8985 (RACK-TLP). Packets are never retransmitted, only their fragments, in new packets: so an
acknowledgement is never ambiguous. Deviations: until reordering was seen, three later packets suffice without a window;
probe timeouts stay at 100 ms on fast paths (see :mod:`udp_mesh.core.rtt`).
Consecutive packets of one message that left together are one entry here, divided only when a part arrives or is lost.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from udp_mesh.core.messages import Transfer
from udp_mesh.core.rtt import RttEstimator
from udp_mesh.core.wire import Ack

REORDERING_THRESHOLD = 3
_REMEMBERED_LOSSES = 1024
_MAX_REORDERING_STEPS = 8


class SentRun(NamedTuple):
    """Consecutive packets of one size that left together and have to be acknowledged; often only one.

    The k-th, number ``packet_number + k``, carries fragment ``index + k`` of each (transfer, index) in ``parts``; there
    is exactly one part if there is more than one packet. ``delivered_*`` are the flow's counters when they left.
    """

    packet_number: int
    packet_count: int
    sent_at_s: float
    size_bytes: int
    """Of each packet."""
    priority: int
    parts: tuple[tuple[Transfer, int], ...]
    delivered_bytes: int
    delivered_at_s: float

    @property
    def last(self) -> int:
        """Number of the last packet."""
        return self.packet_number + self.packet_count - 1

    def cut(self, first: int, last: int) -> SentRun:
        """Return the packets from ``first`` to ``last``, which have to be among these."""
        if first == self.packet_number and last == self.last:
            return self
        skipped = first - self.packet_number
        parts = tuple((transfer, index + skipped) for transfer, index in self.parts)
        return self._replace(packet_number=first, packet_count=last - first + 1, parts=parts)


@dataclass(slots=True)
class AckOutcome:
    """What one acknowledgement changed. ``rate_bps``: 0 when it gave no sample."""

    acked: list[SentRun] = field(default_factory=list)
    lost: list[SentRun] = field(default_factory=list)
    acked_packets: int = 0
    acked_bytes: int = 0
    lost_packets: int = 0
    rtt_sampled: bool = False
    one_way_s: float = 0.0
    received_us: int = 0
    newest_bytes: int = 0
    rate_bps: float = 0.0


class Recovery:
    """Packets sent to one epoch of a peer."""

    def __init__(self, *, rtt: RttEstimator, now: float) -> None:
        self.rtt = rtt
        self.next_packet_number = 0
        self.in_flight_bytes = 0
        self.expirations = 0
        self.lost_packets = 0
        self.spurious_losses = 0
        self._in_flight: list[SentRun] = []  # by packet number
        self._packets = 0
        self._by_priority: dict[int, int] = {}
        self._rack_number = -1  # the latest sent of those delivered
        self._reordering_seen = False
        self._reordering_steps = 1
        self._declared_lost: list[int] = []  # sorted
        self._loss_at_s: float | None = None
        self._last_sent_s = now
        self._delivered_bytes = 0
        self._delivered_at_s = now

    def __len__(self) -> int:
        """Packets in flight."""
        return self._packets

    def take_packet_number(self, count: int = 1) -> int:
        """Return the number of the next packet, of whatever kind; with ``count``, the first of that many."""
        number = self.next_packet_number
        self.next_packet_number += count
        return number

    def on_sent(
        self,
        number: int,
        *,
        count: int = 1,
        size_bytes: int,
        priority: int,
        parts: tuple[tuple[Transfer, int], ...],
        now: float,
    ) -> None:
        """Follow ``count`` packets of ``size_bytes`` each that ask for an acknowledgement; see :class:`SentRun`."""
        if not self._in_flight:
            self._delivered_at_s = now  # an idle time is no part of a rate sample
        self._in_flight.append(
            SentRun(number, count, now, size_bytes, priority, parts, self._delivered_bytes, self._delivered_at_s)
        )
        self._packets += count
        self.in_flight_bytes += count * size_bytes
        self._by_priority[priority] = self._by_priority.get(priority, 0) + count
        self._last_sent_s = now

    def on_ack(self, ack: Ack, *, now: float) -> AckOutcome | None:
        """Take an acknowledgement; None if it covers packets that were never sent."""
        if ack.largest >= self.next_packet_number:
            return None
        outcome = AckOutcome()
        for first, last in ack.ranges:
            if not self._in_flight or last < self._in_flight[0].packet_number:
                break
            outcome.acked += self._take(first, last)
        for run in outcome.acked:
            outcome.acked_packets += run.packet_count
            outcome.acked_bytes += run.packet_count * run.size_bytes
        self._note_spurious(ack.ranges)
        if outcome.acked:
            self._on_progress(ack, outcome, now=now)
        outcome.lost = self.detect_lost(now=now)
        outcome.lost_packets = sum(run.packet_count for run in outcome.lost)
        return outcome

    def _take(self, first: int, last: int) -> list[SentRun]:
        """Take all packets from ``first`` to ``last`` out of flight, dividing runs that are covered in part."""
        runs = self._in_flight
        low = high = bisect_left(runs, first, key=_last_number)
        taken: list[SentRun] = []
        kept: list[SentRun] = []
        while high < len(runs) and runs[high].packet_number <= last:
            run = runs[high]
            inside = run.cut(max(first, run.packet_number), min(last, run.last))
            if inside.packet_number > run.packet_number:
                kept.append(run.cut(run.packet_number, inside.packet_number - 1))
            if inside.last < run.last:
                kept.append(run.cut(inside.last + 1, run.last))
            taken.append(inside)
            self._forget(inside)
            high += 1
        runs[low:high] = kept
        return taken

    def _note_spurious(self, ranges: Iterable[tuple[int, int]]) -> None:
        lost = self._declared_lost
        for first, last in ranges:
            if not lost or last < lost[0]:
                return
            low, high = bisect_left(lost, first), bisect_right(lost, last)
            if low < high:
                del lost[low:high]
                self.spurious_losses += high - low
                self._reordering_seen = True
                self._reordering_steps = min(self._reordering_steps + high - low, _MAX_REORDERING_STEPS)

    def _on_progress(self, ack: Ack, outcome: AckOutcome, *, now: float) -> None:
        self.expirations = 0
        newest = max(outcome.acked, key=_last_number)
        if min(run.packet_number for run in outcome.acked) < self._rack_number:
            self._reordering_seen = True
        self._rack_number = max(self._rack_number, newest.last)
        if newest.last == ack.largest:
            self.rtt.update(now - newest.sent_at_s, ack_delay_s=ack.delay_us / 1e6)
            outcome.rtt_sampled = True
            outcome.one_way_s = _one_way_s(ack.received_us, newest.sent_at_s)
            outcome.received_us, outcome.newest_bytes = ack.received_us, newest.size_bytes
        self._delivered_bytes += outcome.acked_bytes
        elapsed_s = now - newest.delivered_at_s
        if elapsed_s > 0:
            outcome.rate_bps = 8 * (self._delivered_bytes - newest.delivered_bytes) / elapsed_s
        self._delivered_at_s = now

    def detect_lost(self, *, now: float) -> list[SentRun]:
        """Return packets that count as lost from now on, and set the time of the next check."""
        self._loss_at_s = None
        lost_to = -1
        for run in self._in_flight:
            if run.packet_number > self._rack_number:
                break
            for last, window_s in self._reordering_windows(run):
                due_s = run.sent_at_s + self.rtt.latest_s + window_s
                if due_s > now:
                    self._loss_at_s = due_s
                    break
                lost_to = last
            if self._loss_at_s is not None:
                break
        return self._declare_lost(lost_to) if lost_to >= 0 else []

    def _declare_lost(self, last: int) -> list[SentRun]:
        lost = self._take(0, last)
        for run in lost:
            self.lost_packets += run.packet_count
            for number in range(run.packet_number, run.last + 1):
                insort(self._declared_lost, number)
        del self._declared_lost[:-_REMEMBERED_LOSSES]
        return lost

    def _reordering_windows(self, run: SentRun) -> Iterator[tuple[int, float]]:
        """Yield how long the packets of a run may be late, as (last packet number, seconds)."""
        usual_s = min(self._reordering_steps * self.rtt.min_s / 4, self.rtt.srtt_s)
        condemned = self._rack_number - REORDERING_THRESHOLD
        if not self._reordering_seen and run.packet_number <= condemned:
            yield min(run.last, condemned), 0.0
            if run.last <= condemned:
                return
        yield run.last, usual_s

    def _forget(self, run: SentRun) -> None:
        self._packets -= run.packet_count
        self.in_flight_bytes -= run.packet_count * run.size_bytes
        self._by_priority[run.priority] -= run.packet_count

    def next_timer(self) -> float | None:
        """Return when to call :meth:`detect_lost` or, at :attr:`probe_at_s`, to probe; None if nothing is in flight."""
        if not self._in_flight:
            return None
        probe_at_s = self.probe_at_s
        return probe_at_s if self._loss_at_s is None else min(self._loss_at_s, probe_at_s)

    @property
    def probe_at_s(self) -> float:
        """When silence makes a probe due, if packets are in flight."""
        return self._last_sent_s + self.rtt.probe_timeout_s(expirations=self.expirations)

    def on_probe_timeout(self, *, now: float) -> SentRun:
        """Count an expired probe timeout; return the packet whose fragments are worth sending again: the most urgent.

        It stays in flight: whether it was lost is decided by what the probe's acknowledgement says.
        """
        self.expirations += 1
        self._last_sent_s = now  # the next timeout counts from here even if nothing can be sent
        run = min(self._in_flight, key=lambda r: (r.priority, r.packet_number))
        return run.cut(run.packet_number, run.packet_number)

    def urgent_in_flight(self, priority: int) -> int:
        """Return how many packets at least as urgent as ``priority`` are in flight."""
        return sum(count for level, count in self._by_priority.items() if level <= priority)

    def abandon(self) -> list[SentRun]:
        """Give up on everything in flight (the peer is silent); return it in the order in which it was sent."""
        runs = self._in_flight
        self._in_flight = []
        self._packets = 0
        self._by_priority.clear()
        self.in_flight_bytes = 0
        self.expirations = 0
        self._loss_at_s = None
        return runs


def _last_number(run: SentRun) -> int:
    return run.last


def _one_way_s(received_us: int, sent_at_s: float) -> float:
    """Return arrival (peer's clock, modulo 2**32 us) minus departure (ours): delay plus a constant, within +-35 min."""
    difference_us = (received_us - int(sent_at_s * 1e6)) & 0xFFFFFFFF
    return (difference_us - (1 << 32) if difference_us >= 1 << 31 else difference_us) / 1e6
