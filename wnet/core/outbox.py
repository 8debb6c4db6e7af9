"""What leaves this node: queues per member, acknowledgements, frames that share one, the seal, the rate.

The owner of the mesh pulls, so that a queue is here, where urgent frames overtake, and not in a driver.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import islice

from wnet.core import wire, wire_control
from wnet.core.context import Context
from wnet.core.events import Count, Drop
from wnet.core.link import Link
from wnet.core.members import Outgoing
from wnet.core.queues import CLASSES, MemberQueue
from wnet.core.rates import rate_for
from wnet.core.retries import ACK_TURN_S, Retries
from wnet.core.seal import SEAL_BYTES, Seal
from wnet.core.transmissions import Transmission

CONTROL = 0
"""The urgency of everything that is not data."""
ACKS_AT_ONCE = 8
"""So many frames are acknowledged without waiting for more."""
FRAME_OVERHEAD_S = 100e-6
"""What a radio spends on a frame beside its bits: preamble, access, the acknowledgement of the MAC."""
_MAX_CONTROL = 256
_MOST_BYTES = 1 << 16
_MAX_LATER = 1024
_FEWEST_BYTES = wire.AGGREGATED_BYTES + wire.HEADER_BYTES + wire.ETHERNET_BYTES

_CONTROL_KINDS = frozenset((wire.HELLO, wire.TC, wire.PROBE))


class Outbox:
    """The frames of one node that have not left yet. ``retries`` is to be told what leaves."""

    def __init__(
        self,
        context: Context,
        seal: Seal | None,
        on_closed: Callable[[Transmission, float], None],
    ) -> None:
        """``on_closed``: called with what cannot be sent, as all of its next hops have become unusable."""
        config, members = context.config, context.members
        self._config = config
        self._members = members
        self._journal = context.journal
        self._seal = seal
        self._on_closed = on_closed
        self.retries: Retries
        self._queues = [MemberQueue(config.queue_frames, config.queue_target_s) for _ in members]
        self._control: list[deque[tuple[bytes, bytes]]] = [deque(maxlen=_MAX_CONTROL) for _ in members]
        self._owing: list[dict[Link, None]] = [{} for _ in members]
        self._later: list[tuple[float, int, Transmission]] = []
        self._order = 0
        self.busy_s = 0.0
        """Airtime spent so far, reckoned."""
        self._limits = [member.mtu_bytes - (SEAL_BYTES if seal else 0) for member in members]

    @property
    def lengths(self) -> tuple[int, ...]:
        """Frames waiting, by urgency."""
        return tuple(sum(queue.lengths[urgency] for queue in self._queues) for urgency in range(CLASSES))

    def limit_bytes(self, member: int) -> int:
        """How long a body may be on a member."""
        return self._limits[member]

    @property
    def least_limit_bytes(self) -> int:
        """How long a body may be on every member."""
        return min(self._limits, default=_MOST_BYTES)

    # -- in ----------------------------------------------------------------------------------------------------------

    def add_control(self, member: int, head: bytes, body: bytes) -> None:
        """Queue a body that is sent once and asks for nothing; ``head``: its Ethernet header."""
        self._control[member].append((head, body))

    def submit(self, transmission: Transmission, *, now: float, is_first: bool = False) -> None:
        """Queue a transmission; its entries are on its member."""
        transmission.queued_at = now
        dropped = self._queues[transmission.member].push(transmission, is_first=is_first)
        if dropped is not None:
            self._drop(dropped, Drop.QUEUE_FULL, now)

    def submit_later(self, transmission: Transmission, delay_s: float, *, now: float) -> None:
        """Queue a transmission when some time has passed."""
        if len(self._later) < _MAX_LATER:
            self._order += 1
            heapq.heappush(self._later, (now + delay_s, self._order, transmission))
        else:
            self.submit(transmission, now=now)

    def owe(self, link: Link, attempt: int, *, place: int, now: float) -> None:
        """Acknowledge what came last, soon.

        ``place``: of this node among the next hops that are asked, from 0. They may not hear each other, and would
        all answer at the same moment; so each waits for its turn.
        """
        link.acks_owed += 1
        link.ack_attempt = attempt
        if link.acks_owed == 1:
            link.ack_due = now + self._config.ack_delay_s + place * ACK_TURN_S
            self._owing[link.member][link] = None
        elif link.acks_owed >= ACKS_AT_ONCE:
            link.ack_due = now

    def take_out(self, link: Link) -> list[Transmission]:
        """Return, and forget, what waits for one next hop only."""
        self._owing[link.member].pop(link, None)
        link.acks_owed = 0
        return list(self._queues[link.member].remove(link))

    def next_due(self) -> float:
        """When the next acknowledgement has to leave, or the next frame that was to wait."""
        due = min((link.ack_due for owing in self._owing for link in owing), default=float("inf"))
        return min(due, self._later[0][0]) if self._later else due

    # -- out ---------------------------------------------------------------------------------------------------------

    def pull(self, *, now: float, room: Sequence[int] | None) -> list[Outgoing]:
        """Return what to send now, each member's most urgent first."""
        found: list[Outgoing] = []
        while self._later and self._later[0][0] <= now:
            self.submit(heapq.heappop(self._later)[2], now=now)
        for member in range(len(self._members)):
            most = None if room is None else max(room[member], 0)
            found.extend(islice(self._pull(member, now), most))
        return found

    def _pull(self, member: int, now: float) -> Iterator[Outgoing]:
        """Yield what may leave; only what was asked for has left."""
        for link in [link for link in self._owing[member] if link.ack_due <= now]:
            if not self._can_carry_ack(member, link):
                yield self._outgoing(member, link.address_pair, self._ack(link), None, CONTROL)
        control = self._control[member]
        while control:
            head, body = control.popleft()
            yield self._outgoing(member, head, body, None, CONTROL)
        queue = self._queues[member]
        while (transmission := queue.pop()) is not None:
            if self._is_sendable(member, transmission, now):
                yield self._send(member, transmission, now)
        for link in [link for link in self._owing[member] if link.ack_due <= now]:
            yield self._outgoing(member, link.address_pair, self._ack(link), None, CONTROL)

    def _can_carry_ack(self, member: int, link: Link) -> bool:
        queue = self._queues[member]
        if not link.has_room():
            return False
        return any(
            queue.lengths[urgency] and queue.following(link, urgency) is not None for urgency in range(1, CLASSES)
        )

    def _is_sendable(self, member: int, transmission: Transmission, now: float) -> bool:
        packet = transmission.packet
        reason = None if packet.urgency == CONTROL else self._too_late(member, transmission, now)
        if reason is not None:
            self._drop(transmission, reason, now)
            return False
        if packet.urgency != CONTROL and not all(entry.link.is_usable for entry in transmission.entries):
            self._on_closed(transmission, now)
        return bool(transmission.entries) or transmission.is_group

    def _too_late(self, member: int, transmission: Transmission, now: float) -> Drop | None:
        if now - transmission.queued_at > self._config.queue_lifetime_s:
            return Drop.LATE
        return Drop.STANDING_QUEUE if self._queues[member].stands(transmission, now=now) else None

    def _drop(self, transmission: Transmission, reason: Drop, now: float) -> None:
        packet = transmission.packet
        for entry in list(transmission.entries):
            self.retries.forget(transmission, entry)
            if entry.link.probe is transmission:
                entry.link.probe = None
        if packet.kind != wire.PROBE:
            size_bytes = len(packet.tail) - wire.ORIGIN_BYTES
            self._journal.drop(reason, packet.source, packet.destination, size_bytes, now=now)

    def _send(self, member: int, transmission: Transmission, now: float) -> Outgoing:
        entries = transmission.entries
        urgency = transmission.packet.urgency
        body = self._body(transmission, now)
        if transmission.is_group and len(entries) != 1:
            head = wire.GROUP + self._members[member].mac + wire.ETHERTYPE
            rate_bps = self._rate(member, [entry.link for entry in entries]) if entries else None
            return self._outgoing(member, head, body, rate_bps, urgency)
        link = entries[0].link
        if transmission.is_group and transmission.packet.kind in (wire.FLOOD, wire.TC):
            return self._outgoing(member, link.group_head, body, None, urgency)
        rate_bps = self._rate(member, [link])
        body = self._with_others(member, link, urgency, body, now)
        return self._outgoing(member, link.address_pair, body, rate_bps, urgency)

    def _body(self, transmission: Transmission, now: float) -> bytes:
        attempt = transmission.attempts
        transmission.attempts += 1
        is_ack_wanted = transmission.tries > 1 and bool(transmission.entries)
        for entry in transmission.entries:
            if entry.sequence >= 0:
                entry.earlier = (*entry.earlier, entry.sequence)
            entry.sequence = entry.link.take_sequence()
        body = transmission.body(attempt, is_ack_wanted)
        if is_ack_wanted:
            self.retries.sent(transmission, now=now)
        return body

    def _with_others(self, member: int, link: Link, urgency: int, body: bytes, now: float) -> bytes:
        """Add to a frame what goes to the same next hop: an acknowledgement, and small frames as urgent as it."""
        limit = self._limits[member]
        bodies, size = [body], 1 + wire.AGGREGATED_BYTES + len(body)
        if link.acks_owed and size + wire.AGGREGATED_BYTES + wire_control.ACK_BYTES <= limit:
            bodies.append(self._ack(link))
            size += wire.AGGREGATED_BYTES + wire_control.ACK_BYTES
        most = self._config.aggregate_bytes
        queue = self._queues[member]
        while len(body) <= most and link.has_room():
            following = queue.following(link, urgency)
            if following is None or not self._fits(following, most, limit - size):
                break
            queue.take_following(link, urgency)
            if not self._is_sendable(member, following, now):
                continue
            bodies.append(self._body(following, now))
            size += wire.AGGREGATED_BYTES + len(bodies[-1])
            self._journal.count(Count.AGGREGATED)
        return wire.aggregate(bodies) if len(bodies) > 1 else body

    def _fits(self, following: Transmission, most: int, left: int) -> bool:
        if following.packet.kind not in (wire.UNICAST, wire.PROBE):
            return False
        length = wire.HEADER_BYTES + len(following.packet.tail)
        listing = wire.forward_list_bytes([len(entry.destinations) for entry in following.entries])
        return length <= most and length + listing + _FEWEST_BYTES <= left

    def _ack(self, link: Link) -> bytes:
        link.acks_owed = 0
        link.ack_due = float("inf")
        self._owing[link.member].pop(link, None)
        self._journal.count(Count.ACKS_SENT)
        window = link.data_window
        return wire_control.encode_ack(wire_control.Ack(window.newest or 0, link.ack_attempt, window.bits))

    def _rate(self, member: int, links: list[Link]) -> int | None:
        rates_bps = self._members[member].rates_bps
        return rate_for(rates_bps, links) if rates_bps else None

    def _outgoing(self, member: int, head: bytes, body: bytes, rate_bps: int | None, urgency: int) -> Outgoing:
        kind = body[0]
        if self._seal is not None:
            body = self._seal.seal(head, body)
        frame = head + body
        counts = self._journal.counts
        counts[Count.SENT] += 1
        counts[Count.SENT_BYTES] += len(frame)
        if kind in _CONTROL_KINDS:
            counts[Count.CONTROL_SENT] += 1
            counts[Count.CONTROL_BYTES] += len(frame)
        self.busy_s += FRAME_OVERHEAD_S + 8 * len(frame) / (rate_bps or self._config.channel_bps)
        return Outgoing(member, frame, rate_bps, urgency)
