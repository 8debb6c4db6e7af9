"""Whether a message may leave now: window, pace, and who goes past them. No bytes, no order: that is the scheduler's.

Broadcasts have no acknowledgements and so no window. They leave at the pace of the slowest path known, and what they
take is charged to the pace of every peer, so that unicasts and broadcasts together stay within the carrier's rate.
"""

from __future__ import annotations

from udp_mesh.core.coordination import Coordination
from udp_mesh.core.messages import Transfer
from udp_mesh.core.pacer import Pacer
from udp_mesh.core.peer import Peer
from udp_mesh.core.settings import BROADCAST_NAME
from udp_mesh.core.state import NodeState

UNKNOWN_RATE_BPS = 6e6  # of a carrier on which nothing was measured yet: the slowest that 802.11 networks broadcast at


class Gate:
    """Looks at windows and paces, and keeps that of broadcasts."""

    def __init__(self, state: NodeState, coordination: Coordination) -> None:
        self._state = state
        self._coordination = coordination
        self._broadcast_pacer = Pacer()

    def may_send(self, transfer: Transfer, *, now: float) -> bool:
        """Whether the next packet of a transfer may leave."""
        yields = self._coordination.yield_until_s(transfer, now=now) > now
        if transfer.peer == BROADCAST_NAME:
            return bool(self._state.carriers) and self._broadcast_pacer.next_at_s <= now and not yields
        peer = self._state.peers[transfer.peer]
        if not peer.is_online or self._state.free_at_s(peer.path) > now:
            return False
        if yields:  # probes too: on a crowded channel acknowledgements are late, and more of it would make them later
            return False
        if peer.session.probe_credits > 0:
            return True
        if self.has_window(peer) and peer.pacer.next_at_s <= now:
            return True
        if not self._state.settings.prioritise:
            return False
        # Somebody less urgent fills window or pace: a few urgent packets go past them instead of behind them. With
        # nothing in flight the pace is what is left of a round trip that has since proved shorter.
        recovery = peer.session.recovery
        as_urgent = recovery.urgent_in_flight(transfer.message.policy.priority)
        return as_urgent < peer.congestion.urgent_packets and as_urgent < max(1, len(recovery))

    @staticmethod
    def has_window(peer: Peer, *, packets: int = 1) -> bool:
        """Whether the window takes so many full packets more."""
        congestion = peer.congestion
        return peer.session.recovery.in_flight_bytes + packets * congestion.datagram_bytes <= congestion.cwnd_bytes

    def opens_at_s(self, transfer: Transfer, *, now: float) -> float | None:
        """Return when to ask :meth:`may_send` again; None if only an acknowledgement helps."""
        if self.may_send(transfer, now=now):
            return now
        yield_until_s = self._coordination.yield_until_s(transfer, now=now)
        if transfer.peer == BROADCAST_NAME:
            return max(self._broadcast_pacer.next_at_s, yield_until_s) if self._state.carriers else None
        peer = self._state.peers[transfer.peer]
        if not peer.is_online:
            return None
        opens_at_s = max(self._state.free_at_s(peer.path), yield_until_s)
        if not self.has_window(peer):
            return opens_at_s if opens_at_s > now else None
        return max(peer.pacer.next_at_s, opens_at_s)

    def on_broadcast(self, size_bytes: int, *, now: float) -> None:
        """Charge a broadcast to every pace."""
        online = [peer for peer in self._state.peers.values() if peer.is_online]
        for peer in online:
            peer.pacer.on_sent(size_bytes, rate_bps=peer.congestion.pacing_rate_bps, now=now)
        known = [peer.congestion.capacity_bps for peer in online if peer.congestion.capacity_bps]
        self._broadcast_pacer.on_sent(size_bytes, rate_bps=min(known, default=UNKNOWN_RATE_BPS), now=now)
