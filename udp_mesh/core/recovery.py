"""Loss recovery of one peer's epoch: which packets are in flight, arrived, or lost, and when to probe.

Source: RFC 8985 (RACK-TLP). Packets are never retransmitted, only their fragments, in new packets: so an
acknowledgement is never ambiguous. Deviations: until reordering was seen, three later packets suffice without a window;
probe timeouts stay at 100 ms on fast paths (see :mod:`udp_mesh.core.rtt`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from udp_mesh.core.messages import Transfer
from udp_mesh.core.rtt import RttEstimator
from udp_mesh.core.wire import Ack

REORDERING_THRESHOLD = 3
_REMEMBERED_LOSSES = 1024
_MAX_REORDERING_STEPS = 8


class SentPacket(NamedTuple):
    """A packet that has to be acknowledged. ``delivered_*`` are the flow's counters when it left (rate samples)."""

    packet_number: int
    sent_at_s: float
    size_bytes: int
    priority: int
    parts: tuple[tuple[Transfer, int], ...]
    delivered_bytes: int
    delivered_at_s: float


@dataclass(slots=True)
class AckOutcome:
    """What one acknowledgement changed. ``rate_bps``: 0 when it gave no sample."""

    acked: list[SentPacket] = field(default_factory=list)
    lost: list[SentPacket] = field(default_factory=list)
    acked_bytes: int = 0
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
        self._in_flight: dict[int, SentPacket] = {}
        self._by_priority: dict[int, int] = {}
        self._lowest = 0  # no packet below it is in flight
        self._rack: SentPacket | None = None  # the latest sent of those delivered
        self._reordering_seen = False
        self._reordering_steps = 1
        self._declared_lost: dict[int, None] = {}
        self._loss_at_s: float | None = None
        self._last_sent_s = now
        self._delivered_bytes = 0
        self._delivered_at_s = now

    def __len__(self) -> int:
        """Packets in flight."""
        return len(self._in_flight)

    def take_packet_number(self) -> int:
        """Return the number of the next packet, of whatever kind."""
        number = self.next_packet_number
        self.next_packet_number += 1
        return number

    def on_sent(
        self, number: int, *, size_bytes: int, priority: int, parts: tuple[tuple[Transfer, int], ...], now: float
    ) -> None:
        """Follow a packet that asks for an acknowledgement."""
        if not self._in_flight:
            self._delivered_at_s = now  # an idle time is no part of a rate sample
        self._in_flight[number] = SentPacket(
            number, now, size_bytes, priority, parts, self._delivered_bytes, self._delivered_at_s
        )
        self.in_flight_bytes += size_bytes
        self._by_priority[priority] = self._by_priority.get(priority, 0) + 1
        self._last_sent_s = now

    def on_ack(self, ack: Ack, *, now: float) -> AckOutcome | None:
        """Take an acknowledgement; None if it covers packets that were never sent."""
        if ack.largest >= self.next_packet_number:
            return None
        outcome = AckOutcome()
        newest: SentPacket | None = None
        for number in self._numbers_in_flight(ack.ranges):
            packet = self._in_flight[number]
            self._forget(packet)
            outcome.acked.append(packet)
            outcome.acked_bytes += packet.size_bytes
            if newest is None or packet.packet_number > newest.packet_number:
                newest = packet
        self._note_spurious(ack.ranges)
        if newest is not None:
            self._on_progress(ack, newest, outcome, now=now)
        outcome.lost = self.detect_lost(now=now)
        return outcome

    def _numbers_in_flight(self, ranges: Iterable[tuple[int, int]]) -> list[int]:
        numbers: list[int] = []
        for first, last in ranges:
            if last < self._lowest:
                break
            numbers.extend(n for n in range(max(first, self._lowest), last + 1) if n in self._in_flight)
        return numbers

    def _note_spurious(self, ranges: Iterable[tuple[int, int]]) -> None:
        if not self._declared_lost:
            return
        for first, last in ranges:
            for number in [n for n in self._declared_lost if first <= n <= last]:
                del self._declared_lost[number]
                self.spurious_losses += 1
                self._reordering_seen = True
                self._reordering_steps = min(self._reordering_steps + 1, _MAX_REORDERING_STEPS)

    def _on_progress(self, ack: Ack, newest: SentPacket, outcome: AckOutcome, *, now: float) -> None:
        self.expirations = 0
        if self._rack is not None and min(p.packet_number for p in outcome.acked) < self._rack.packet_number:
            self._reordering_seen = True
        if self._rack is None or newest.packet_number > self._rack.packet_number:
            self._rack = newest
        if newest.packet_number == ack.largest:
            self.rtt.update(now - newest.sent_at_s, ack_delay_s=ack.delay_us / 1e6)
            outcome.rtt_sampled = True
            outcome.one_way_s = _one_way_s(ack.received_us, newest.sent_at_s)
            outcome.received_us, outcome.newest_bytes = ack.received_us, newest.size_bytes
        self._delivered_bytes += outcome.acked_bytes
        elapsed_s = now - newest.delivered_at_s
        if elapsed_s > 0:
            outcome.rate_bps = 8 * (self._delivered_bytes - newest.delivered_bytes) / elapsed_s
        self._delivered_at_s = now

    def detect_lost(self, *, now: float) -> list[SentPacket]:
        """Return packets that count as lost from now on, and set the time of the next check."""
        self._loss_at_s = None
        lost: list[SentPacket] = []
        if self._rack is None:
            return lost
        for packet in self._ordered(self._rack.packet_number):
            due_s = packet.sent_at_s + self.rtt.latest_s + self._reordering_window_s(packet.packet_number)
            if due_s > now:
                self._loss_at_s = due_s
                break
            lost.append(packet)
        for packet in lost:
            self._forget(packet)
            self._declared_lost[packet.packet_number] = None
            if len(self._declared_lost) > _REMEMBERED_LOSSES:
                del self._declared_lost[next(iter(self._declared_lost))]
        self.lost_packets += len(lost)
        return lost

    def _reordering_window_s(self, number: int) -> float:
        later = 0 if self._rack is None else self._rack.packet_number - number
        if not self._reordering_seen and later >= REORDERING_THRESHOLD:
            return 0.0
        return min(self._reordering_steps * self.rtt.min_s / 4, self.rtt.srtt_s)

    def _ordered(self, end: int) -> Iterator[SentPacket]:
        while self._lowest < self.next_packet_number and self._lowest not in self._in_flight:
            self._lowest += 1
        for number in range(self._lowest, end):
            packet = self._in_flight.get(number)
            if packet is not None:
                yield packet

    def _forget(self, packet: SentPacket) -> None:
        del self._in_flight[packet.packet_number]
        self.in_flight_bytes -= packet.size_bytes
        self._by_priority[packet.priority] -= 1

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

    def on_probe_timeout(self, *, now: float) -> SentPacket:
        """Count an expired probe timeout; return the packet whose fragments are worth sending again: the most urgent.

        It stays in flight: whether it was lost is decided by what the probe's acknowledgement says.
        """
        self.expirations += 1
        self._last_sent_s = now  # the next timeout counts from here even if nothing can be sent
        return min(self._in_flight.values(), key=lambda p: (p.priority, p.packet_number))

    def urgent_in_flight(self, priority: int) -> int:
        """Return how many packets at least as urgent as ``priority`` are in flight."""
        return sum(count for level, count in self._by_priority.items() if level <= priority)

    def abandon(self) -> list[SentPacket]:
        """Give up on everything in flight (the peer is silent); return it in the order in which it was sent."""
        packets = list(self._in_flight.values())
        self._in_flight.clear()
        self._by_priority.clear()
        self.in_flight_bytes = 0
        self.expirations = 0
        self._loss_at_s = None
        return packets


def _one_way_s(received_us: int, sent_at_s: float) -> float:
    """Return arrival (peer's clock, modulo 2**32 us) minus departure (ours): delay plus a constant, within +-35 min."""
    difference_us = (received_us - int(sent_at_s * 1e6)) & 0xFFFFFFFF
    return (difference_us - (1 << 32) if difference_us >= 1 << 31 else difference_us) / 1e6
