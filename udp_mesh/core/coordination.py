"""Robots that share a medium yield to each other: whoever has something urgent waiting says so, others step back.

Theory of operation. A node whose most urgent message has waited for ``BACKLOG_AFTER_S`` broadcasts its priority
(BACKLOG), and again every ``ANNOUNCE_INTERVAL_S`` while that lasts. For ``HOLD_S`` after hearing it, the others send
what is less urgent than that only at ``YIELD_SHARE`` of the rate that their paths carry: enough to go on measuring
them, and for nothing to starve. Nodes only know of those that they hear; who is not heard is hardly disturbed.
"""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.messages import Transfer
from udp_mesh.core.pacer import Pacer
from udp_mesh.core.settings import BROADCAST_NAME
from udp_mesh.core.state import NodeState

BACKLOG_AFTER_S = 0.05
ANNOUNCE_INTERVAL_S = 0.1
HOLD_S = 0.25
YIELD_SHARE = 0.1
_UNKNOWN_RATE_BPS = 6e6


class Coordination:
    """What this node announces, and when it yields. Does nothing unless ``Settings.coordinate``."""

    def __init__(self, state: NodeState) -> None:
        self._state = state
        self._announced_at_s = float("-inf")
        self._pacer = Pacer()

    def announcement(self, *, now: float) -> bytes:
        """Return the frame to broadcast now; empty if none is due."""
        due_s = self.next_timer()
        if due_s is None or due_s > now:
            return b""
        self._announced_at_s = now
        priority = min(t.message.policy.priority for t in self._waiting() if _backlog_at_s(t) <= now)
        return wire.encode_backlog(priority)

    def next_timer(self) -> float | None:
        """Return when the next announcement is due if nothing changes."""
        if not self._state.settings.coordinate:
            return None
        first_s = min(map(_backlog_at_s, self._waiting()), default=None)
        return None if first_s is None else max(first_s, self._announced_at_s + ANNOUNCE_INTERVAL_S)

    def _waiting(self) -> list[Transfer]:
        """Return the most urgent transfer of every destination that can be reached."""
        peers = self._state.peers
        return [t for t in self._state.scheduler.heads() if t.peer != BROADCAST_NAME and peers[t.peer].is_online]

    def yield_until_s(self, transfer: Transfer, *, now: float) -> float:
        """Return until when a transfer leaves the medium to others; ``now`` or before if it need not."""
        if not self._yields(transfer.message.policy.priority, now=now):
            return now
        return self._pacer.next_at_s

    def _yields(self, priority: int, *, now: float) -> bool:
        if not self._state.settings.coordinate:
            return False
        peers = self._state.peers.values()
        return any(peer.backlog_priority < priority and now < peer.backlog_until_s for peer in peers)

    def on_sent(self, priority: int, size_bytes: int, *, capacity_bps: float, now: float) -> None:
        """Charge what left to the share that is used while yielding."""
        if self._yields(priority, now=now):
            self._pacer.on_sent(size_bytes, rate_bps=YIELD_SHARE * (capacity_bps or _UNKNOWN_RATE_BPS), now=now)


def _backlog_at_s(transfer: Transfer) -> float:
    return transfer.message.queued_at_s + BACKLOG_AFTER_S
