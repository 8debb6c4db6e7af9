"""The receiving side of packet numbers: duplicates, and when and what to acknowledge."""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.rangeset import RangeSet

MAX_ACK_DELAY_S = 0.004
MAX_ACK_LATER_S = 0.02
RUN_ACK_DELAY_S = 0.0005
PACKETS_PER_ACK = 2
ALERT_PACKETS = 3  # after a gap: so many later ones prove a loss (RFC 8985, section 7.2)
REPORTED_RANGES = 32
_REMEMBERED_RANGES = 256


class AckTracker:
    """Packets received from one peer's epoch."""

    __slots__ = ("_alert_until", "_due_at_s", "_highest_at_s", "_numbers", "_pending")

    def __init__(self) -> None:
        self._numbers = RangeSet(max_ranges=_REMEMBERED_RANGES)
        self._alert_until = -1
        self._highest_at_s = 0.0
        self._pending = 0
        self._due_at_s: float | None = None

    def is_duplicate(self, packet_number: int) -> bool:
        """Whether this packet was received before (or is so old that it is treated so)."""
        return packet_number in self._numbers

    def record(
        self, packet_number: int, *, is_ack_eliciting: bool, ack_now: bool, ack_later: bool = False, now: float
    ) -> None:
        """Remember a packet. Out of order, asked for, or every second one: acknowledged at once, else within 4 ms.

        ``ack_later``: that it is a second one is no reason to hurry; but soon after a gap the sender waits for proof
        of the loss.
        """
        highest = self._numbers.highest
        self._numbers.add(packet_number)
        if packet_number > highest:
            self._highest_at_s = now
        if not is_ack_eliciting:
            return
        self._pending += 1
        if packet_number > highest + 1:
            self._alert_until = packet_number + ALERT_PACKETS
        may_wait = ack_later and packet_number > self._alert_until
        if ack_now or packet_number != highest + 1 or (self._pending >= PACKETS_PER_ACK and not may_wait):
            self._due_at_s = now
        elif self._due_at_s is None:
            self._due_at_s = now + (MAX_ACK_LATER_S if may_wait else MAX_ACK_DELAY_S)

    def is_new_run(self, packet_number: int) -> bool:
        """Whether this packet and all later ones were never received."""
        return packet_number > self._numbers.highest and packet_number >= self._numbers.floor

    def record_run(self, first: int, last: int, *, ack_now: bool, now: float) -> None:
        """Remember a run of packets with data, of which :meth:`is_new_run` holds.

        Runs are acknowledged at the latest after half a millisecond: on a path that carries runs they come faster.
        """
        in_order = first == self._numbers.highest + 1
        self._numbers.add_range(first, last)
        self._highest_at_s = now
        self._pending += last - first + 1
        delay_s = 0.0 if ack_now or not in_order else RUN_ACK_DELAY_S
        self._due_at_s = now + delay_s if self._due_at_s is None else min(self._due_at_s, now + delay_s)

    def repeat(self, *, now: float) -> None:
        """Acknowledge at once what is known already: a duplicate may mean that the acknowledgement was lost."""
        if self._numbers:
            self._pending += 1
            self._due_at_s = now

    @property
    def has_pending(self) -> bool:
        """Whether something was received that no acknowledgement covers."""
        return self._pending > 0

    @property
    def due_at_s(self) -> float | None:
        """When the next acknowledgement has to leave."""
        return self._due_at_s

    def take(self, *, room_bytes: int, now: float) -> bytes:
        """Return the frame that acknowledges everything received, and count it as sent."""
        self._pending = 0
        self._due_at_s = None
        return wire.encode_ack(
            self._numbers.newest(REPORTED_RANGES),
            received_us=int(self._highest_at_s * 1e6),
            delay_us=int((now - self._highest_at_s) * 1e6),
            room_bytes=room_bytes,
        )
