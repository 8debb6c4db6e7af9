"""Builds the datagrams that may leave now: acknowledgements and control first, then data by the scheduler's order."""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.broadcasts import Broadcasts
from udp_mesh.core.coordination import Coordination
from udp_mesh.core.copies import Copies
from udp_mesh.core.datagram import CONTROL_PRIORITY, Datagram
from udp_mesh.core.events import FragmentCopied, FragmentRetransmitted, FragmentSent
from udp_mesh.core.gate import Gate
from udp_mesh.core.messages import Transfer
from udp_mesh.core.outbox import Outbox
from udp_mesh.core.peer import Path, Peer
from udp_mesh.core.settings import BROADCAST_NAME
from udp_mesh.core.starvation import StarvationFloor
from udp_mesh.core.state import NodeState
from udp_mesh.core.wire_runs import encode_run

MAX_DATAGRAMS_PER_TURN = 88
MAX_RUN_PACKETS = 44  # of 1400 bytes: what the kernel takes in one call
_MAX_RUN_BYTES = 63_000
FLOOR_EVERY_MESSAGES = 64
_FLOOR_BYTES = len(wire.encode_floor(0))
_MIN_ACK_ROOM_BYTES = 64
_PING_PRIORITY = 255  # when all is silent, data is worth repeating before a ping


class Transmitter:
    """Sends within each peer's window and pace."""

    def __init__(self, state: NodeState, outbox: Outbox) -> None:
        self._state = state
        self._outbox = outbox
        self.broadcasts = Broadcasts(state)
        self._copies = Copies()
        self._coordination = Coordination(state)
        self._gate = Gate(state, self._coordination)
        self._floor = StarvationFloor(state.scheduler)

    def datagrams(self, *, now: float) -> list[Datagram]:
        """Return what may leave now; with much to send only the first part, so that the caller can receive between."""
        out: list[Datagram] = []
        for peer in self._state.peers.values():
            self._control(peer, out, now=now)
        self._outbox.expire(now=now)
        scheduler, settings = self._state.scheduler, self._state.settings
        for copied in self._copies.due(now=now):
            scheduler.push(copied)
        announcement = self._coordination.announcement(now=now)
        if announcement:
            out.extend(self.broadcasts.control(announcement, now=now))

        def can_send(transfer: Transfer) -> bool:
            return self._gate.may_send(transfer, now=now)

        room = MAX_DATAGRAMS_PER_TURN
        while room > 0:
            transfer = scheduler.pick(can_send)
            if transfer is None:
                break
            starved = self._floor.due(transfer, can_send, ratio=settings.floor_ratio)
            room -= self._send(starved or transfer, out, limit=1 if settings.floor_ratio else room, now=now)
            if starved is None:
                self._floor.on_sent(len(out[-1].data) if out else 0, ratio=settings.floor_ratio)
        for peer in self._state.peers.values():
            head = scheduler.head(peer.name) if peer.is_online else None
            peer.was_limited = head is not None and self._coordination.yield_until_s(head, now=now) <= now
        return out

    def most_urgent(self, carrier: int, *, now: float) -> int | None:
        """Return the priority of the message to a peer that may leave by a carrier now; None if there is none."""

        def may_leave(transfer: Transfer) -> bool:
            peer = self._state.peers.get(transfer.peer)
            return peer is not None and peer.path.carrier == carrier and self._gate.may_send(transfer, now=now)

        transfer = self._state.scheduler.pick(may_leave)
        return None if transfer is None else transfer.message.policy.priority

    def _send(self, transfer: Transfer, out: list[Datagram], *, limit: int, now: float) -> int:
        """Build the next packets of a transfer, at most ``limit``; return how many."""
        priority = transfer.message.policy.priority
        capacity_bps, count = 0.0, 1
        if transfer.peer == BROADCAST_NAME:
            self._send_broadcast(transfer, out, now=now)
        else:
            peer = self._state.peers[transfer.peer]
            capacity_bps = peer.congestion.capacity_bps
            count = self._run_length(peer, transfer, limit=limit, now=now)
            if count > 1:
                out.append(self._run(peer, transfer, count, now=now))
            else:
                out.append(self._data(peer, transfer, now=now))
        self._coordination.on_sent(priority, len(out[-1].data) if out else 0, capacity_bps=capacity_bps, now=now)
        return count

    def next_timer(self, *, now: float) -> float | None:
        """Return when something may leave that cannot leave now; ``now`` if more waits than one turn takes."""
        times = [self._peer_timer(peer, now=now) for peer in self._state.peers.values()]
        broadcast = self._state.scheduler.head(BROADCAST_NAME)
        if broadcast is not None:
            times.append(self._gate.opens_at_s(broadcast, now=now))
        times += (self._copies.next_timer(), self._coordination.next_timer())
        return min((time for time in times if time is not None), default=None)

    def _peer_timer(self, peer: Peer, *, now: float) -> float | None:
        session = peer.session
        if not peer.is_online:
            return None
        if session.control or session.ping_wanted:
            return now
        due_s = session.acks.due_at_s
        head = self._state.scheduler.head(peer.name)
        if head is not None:
            opens_at_s = self._gate.opens_at_s(head, now=now)
            if opens_at_s is not None:
                return opens_at_s if due_s is None else min(due_s, opens_at_s)
        return due_s

    def _control(self, peer: Peer, out: list[Datagram], *, now: float) -> None:
        session = peer.session
        due_s = session.acks.due_at_s
        is_due = session.control or session.ping_wanted or (due_s is not None and due_s <= now)
        if not peer.is_online or not (is_due or (session.greeting and self._state.scheduler.head(peer.name))):
            return
        frames = session.greeting + session.control
        session.greeting, session.control = [], []
        path = peer.ack_path(self._state.carriers) if session.acks.has_pending else peer.path
        if session.acks.has_pending:
            room_bytes = self._state.packet_bytes(path) - wire.HEADER_BYTES - sum(map(len, frames))
            frames.append(session.acks.take(room_bytes=room_bytes, now=now))
        parts: list[tuple[Transfer, int]] | None = None
        if session.ping_wanted:
            session.ping_wanted = False
            frames.append(wire.PING)
            parts = []
        out.append(
            self._packet(peer, frames, parts, priority=_PING_PRIORITY, flags=wire.FLAG_ACK_NOW, path=path, now=now)
        )

    def _run_length(self, peer: Peer, transfer: Transfer, *, limit: int, now: float) -> int:
        """Return how many packets of nothing but this message may leave now; less than 2 is no run."""
        session, congestion = peer.session, peer.congestion
        message, index = transfer.message, transfer.peek()
        if index is None or index + 2 >= message.fragment_count or message.leaves_twice:
            return 1
        if self._state.rate_bps(peer.path):  # one by one, so that something urgent need not wait for a run
            return 1
        packet_bytes = wire.HEADER_BYTES + message.fragment_bytes(index)
        window = (congestion.cwnd_bytes - session.recovery.in_flight_bytes) // packet_bytes
        limit = min(limit, MAX_RUN_PACKETS, _MAX_RUN_BYTES // packet_bytes, window)
        if limit < 2 or session.probe_credits or self._coordination.holds_back(message.policy.priority, now=now):
            return 1
        paced = peer.pacer.packets_now(packet_bytes, rate_bps=congestion.pacing_rate_bps, limit=limit, now=now)
        return max(1, transfer.run_length(paced))

    def _run(self, peer: Peer, transfer: Transfer, count: int, *, now: float) -> Datagram:
        """Build packets of consecutive fragments, each in a packet of its own."""
        session, message, first = peer.session, transfer.message, transfer.peek()
        assert first is not None
        number = session.recovery.take_packet_number(count)
        for k in range(count) if transfer.retransmits_next or self._state.settings.trace_fragments else ():
            self._note_fragment(transfer, first + k, number + k, now=now)
        transfer.advance(number, count)
        packet_bytes = wire.HEADER_BYTES + message.fragment_bytes(first)
        in_flight_bytes = session.recovery.in_flight_bytes + count * packet_bytes
        data = encode_run(
            epoch=self._state.epoch,
            destination_tag=session.tag,
            packet_number=number,
            message_id=message.message_id,
            priority=message.policy.priority,
            flags=message.flags,
            fragment_index=first,
            fragment_count=message.fragment_count,
            prefix=message.topic_prefix if first == 0 else b"",
            payloads=message.payloads(first, count),
            ack_now=in_flight_bytes + packet_bytes > peer.congestion.cwnd_bytes,
        )
        self._follow(peer, number, count, packet_bytes, ((transfer, first),), message.policy.priority, now=now)
        return Datagram(peer.path, data, packet_bytes, message.policy.priority)

    def _data(self, peer: Peer, transfer: Transfer, *, now: float) -> Datagram:
        """Build one packet: the next fragment, and what else of this peer's queue fits behind it."""
        session, scheduler = peer.session, self._state.scheduler
        number = session.recovery.next_packet_number
        frames: list[bytes | memoryview] = []
        parts: list[tuple[Transfer, int]] = []
        room = peer.congestion.datagram_bytes - wire.HEADER_BYTES
        priority = transfer.message.policy.priority
        repeats = transfer.retransmits_next
        following: Transfer | None = transfer
        while following is not None:
            index = following.peek()
            if index is None or (parts and following.message.fragment_bytes(index) > room):
                break
            self._note_fragment(following, index, number, now=now)
            frames.extend(following.message.fragment(index))
            room -= following.message.fragment_bytes(index)
            following.advance(number)
            self._copies.note_sent(following, index, now=now)
            parts.append((following, index))
            following = scheduler.head(peer.name) if room > wire.DATA_BYTES else None
        returns_here = peer.ack_path(self._state.carriers).carrier == peer.path.carrier
        if session.acks.has_pending and room >= _MIN_ACK_ROOM_BYTES and returns_here:
            ack = session.acks.take(room_bytes=room, now=now)
            frames.append(ack)
            room -= len(ack)
        self._add_floor(peer, frames, room)
        session.probe_credits = max(0, session.probe_credits - 1)
        return self._packet(
            peer, frames, parts, priority=priority, flags=self._ack_flags(peer, frames, repeats=repeats), now=now
        )

    def _ack_flags(self, peer: Peer, frames: list[bytes | memoryview], *, repeats: bool) -> int:
        """Return whether a packet asks for an acknowledgement; ``repeats``: see :meth:`AckRequests.flags`."""
        stalls = self._state.scheduler.head(peer.name) is None or not self._gate.has_window(peer, packets=2)
        return peer.session.ack_requests.flags(
            wire.HEADER_BYTES + sum(map(len, frames)),
            stalls=stalls,
            repeats=repeats,
            spacing_bytes=peer.congestion.ack_spacing_bytes,
        )

    def _note_fragment(self, transfer: Transfer, index: int, number: int, *, now: float) -> None:
        what = (now, transfer.message.message_id, transfer.message.policy.priority, index, number, transfer.peer)
        if transfer.retransmits_next:
            self._state.counters["fragments_retransmitted"] += 1
            self._state.events.append(FragmentRetransmitted(*what))
        elif transfer.copies_next:
            self._state.counters["fragments_copied"] += 1
            self._state.events.append(FragmentCopied(*what))
        elif self._state.settings.trace_fragments:
            self._state.events.append(FragmentSent(*what))

    def _add_floor(self, peer: Peer, frames: list[bytes | memoryview], room: int) -> None:
        floor = self._state.floor(peer.lane)
        if room >= _FLOOR_BYTES and floor >= peer.session.floor_sent + FLOOR_EVERY_MESSAGES:
            peer.session.floor_sent = floor
            frames.append(wire.encode_floor(floor))

    def _packet(
        self,
        peer: Peer,
        frames: list[bytes | memoryview] | list[bytes],
        parts: list[tuple[Transfer, int]] | None,
        *,
        priority: int,
        flags: int,
        path: Path | None = None,
        now: float,
    ) -> Datagram:
        """Number a packet and follow it if it is to be acknowledged (``parts`` is not None)."""
        session = peer.session
        number = session.recovery.take_packet_number()
        header = wire.encode_header(
            epoch=self._state.epoch,
            destination_tag=session.tag,
            packet_number=number,
            flags=flags,
        )
        data = b"".join((header, *frames))
        self._follow(peer, number, 1, len(data), None if parts is None else tuple(parts), priority, now=now)
        path = path or peer.path
        self._state.charge(path, len(data), now=now)
        return Datagram(path, data, 0, priority if parts else CONTROL_PRIORITY)

    @staticmethod
    def _follow(
        peer: Peer,
        number: int,
        count: int,
        size_bytes: int,
        parts: tuple[tuple[Transfer, int], ...] | None,
        priority: int,
        *,
        now: float,
    ) -> None:
        """Charge the pace with packets, and follow them if they are to be acknowledged (``parts`` is not None)."""
        if parts is not None:
            peer.session.recovery.on_sent(
                number, count=count, size_bytes=size_bytes, priority=priority, parts=parts, now=now
            )
            if peer.waiting_since_s is None:
                peer.waiting_since_s = now
        peer.last_sent_s = now
        peer.pacer.on_sent(size_bytes, count=count, rate_bps=peer.congestion.pacing_rate_bps, now=now)

    def _send_broadcast(self, transfer: Transfer, out: list[Datagram], *, now: float) -> None:
        number = self.broadcasts.next_number
        self._note_fragment(transfer, 0, number, now=now)
        frames = b"".join(transfer.message.fragment(0))
        datagrams = self.broadcasts.data(frames, priority=transfer.message.policy.priority, now=now)
        out.extend(datagrams)
        self._gate.on_broadcast(len(datagrams[0].data) * self._state.broadcast_copies if datagrams else 0, now=now)
        transfer.advance(number)
        self._copies.note_sent(transfer, 0, now=now)
        if not transfer.has_copy(0):
            self._outbox.sent_broadcast(transfer)
