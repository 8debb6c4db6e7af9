"""Robots that share a medium yield to each other: whoever has something waiting says how urgent, others step back.

Theory of operation. A node whose most urgent message has waited for ``BACKLOG_AFTER_S`` broadcasts its priority
(BACKLOG), and again every ``ANNOUNCE_INTERVAL_S`` while that lasts. For ``HOLD_S`` after hearing it, the others send
what is less urgent than that only at ``YIELD_SHARE`` of the rate that their paths carry: enough to go on measuring
them, and for nothing to starve. Nodes only know of those that they hear; who is not heard is hardly disturbed.

Where it is known what the channel carries (``Settings.shared_bps``), nodes with equally urgent backlogs divide
``DIVIDED_SHARE`` of its time evenly. Stations that all have something to send keep a channel full whatever each one's
congestion control does: a message that waits for nobody at its own node still waits for all others' turns, and a node
that acknowledges for ten gets an eleventh of the turns. What is left over is for what is more urgent, which is charged
to its node's part but not held back, and for acknowledgements.
"""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.airtime import exchange_s
from udp_mesh.core.messages import Transfer
from udp_mesh.core.pacer import Pacer
from udp_mesh.core.settings import BROADCAST_NAME
from udp_mesh.core.state import NodeState

BACKLOG_AFTER_S = 0.05
ANNOUNCE_INTERVAL_S = 0.1
HOLD_S = 0.25
YIELD_SHARE = 0.1
DIVIDED_SHARE = 0.5
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
        return self._pacer.next_at_s if self.holds_back(transfer.message.policy.priority, now=now) else now

    def holds_back(self, priority: int, *, now: float) -> bool:
        """Whether messages of this priority leave at a pace that others' backlogs set."""
        rivals = self._rivals(now=now)
        if not rivals:
            return False
        return priority > min(rivals) or (self._state.settings.shared_bps > 0 and priority == min(rivals))

    def on_sent(self, priority: int, size_bytes: int, *, capacity_bps: float, now: float) -> None:
        """Charge what left to the share that is used meanwhile."""
        rivals = self._rivals(now=now)
        if not rivals:
            return
        shared_bps = self._state.settings.shared_bps
        if priority > min(rivals):
            self._pacer.on_sent(size_bytes, rate_bps=YIELD_SHARE * (capacity_bps or _UNKNOWN_RATE_BPS), now=now)
        elif shared_bps > 0:
            worth_bytes = round(exchange_s(size_bytes, channel_bps=shared_bps) * shared_bps / 8)
            self._pacer.on_sent(worth_bytes, rate_bps=DIVIDED_SHARE * shared_bps / (1 + len(rivals)), now=now)

    def _rivals(self, *, now: float) -> list[int]:
        """How urgent the backlogs are that others have announced."""
        if not self._state.settings.coordinate:
            return []
        return [peer.backlog_priority for peer in self._state.peers.values() if now < peer.backlog_until_s]


def _backlog_at_s(transfer: Transfer) -> float:
    return transfer.message.queued_at_s + BACKLOG_AFTER_S
