"""The search for peers that fell silent: PROBE broadcasts, one for all that are sought.

Every 25 ms for two minutes, then each second, while there is, or was in the last ten minutes, something for such a
peer. No back-off; but never more than ``PROBE_SHARE`` of the channel, nor of what a sought peer's path was seen to
carry. Whoever else is heard searching shares that with us: the answers are broadcasts, which serve all.
"""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.airtime import airtime_s
from udp_mesh.core.peer import NEVER_S, Peer
from udp_mesh.core.state import NodeState

PROBE_INTERVAL_S = 0.025
PROBE_QUICK_FOR_S = 120.0
PROBE_SLOW_INTERVAL_S = 1.0
PROBE_TRAFFIC_WITHIN_S = 600.0
PROBE_RAREST_S = 10.0
PROBE_SHARE = 0.02
PROBE_BYTES = 128  # on the carrier, with its headers
SEARCHER_FORGOTTEN_AFTER_S = 1.0
_MAX_SEARCHERS = 256


class Search:
    """What this node does to find offline peers again."""

    def __init__(self, state: NodeState) -> None:
        self._state = state
        self._probed_at_s = NEVER_S
        self._searchers: dict[int, float] = {}  # epoch of another node that probes -> when it was heard

    def is_sought(self, peer: Peer, *, now: float) -> bool:
        """Whether this node looks for a peer."""
        if peer.is_online or not self._state.settings.probe:
            return False
        return bool(peer.lane.transfers) or now - peer.last_traffic_s <= PROBE_TRAFFIC_WITHIN_S

    def heard_searching(self, epoch: int, tags: tuple[int, ...], *, now: float) -> None:
        """Note that another node probes for one that this node looks for."""
        if len(self._searchers) < _MAX_SEARCHERS and any(p.session.tag in tags for p in self._sought(now=now)):
            self._searchers[epoch] = now

    def next_timer(self, *, now: float) -> float | None:
        """Return when the next probe is due; None if nobody is sought."""
        sought = self._sought(now=now)
        if not sought:
            return None
        newest_s = max(peer.down_since_s for peer in sought)
        is_quick = now - newest_s < PROBE_QUICK_FOR_S
        interval_s = min(_path_interval_s(peer) for peer in sought)  # a carrier carries what its best path does
        interval_s = max(interval_s, self._least_interval_s(len(sought), now=now))
        return self._probed_at_s + (interval_s if is_quick else max(interval_s, PROBE_SLOW_INTERVAL_S))

    def tags(self, *, now: float) -> list[int]:
        """Return whom to ask for now; empty unless a probe is due, which then counts as sent."""
        due_s = self.next_timer(now=now)
        if due_s is None or due_s > now:
            return []
        self._probed_at_s = now
        return [peer.session.tag for peer in self._sought(now=now)]

    def _least_interval_s(self, sought: int, *, now: float) -> float:
        others = sum(now - at_s < SEARCHER_FORGOTTEN_AFTER_S for at_s in self._searchers.values())
        if not others:
            self._searchers.clear()
        name_bytes = len(self._state.settings.name.encode())
        size_bytes = wire.HEADER_BYTES + wire.HELLO_BYTES + name_bytes + len(wire.encode_probe([0])) + 4 * sought
        once_s = airtime_s(size_bytes, channel_bps=self._state.settings.channel_bps)
        own_s = self._state.broadcast_copies * once_s / PROBE_SHARE
        return (1 + others) * (max(own_s, PROBE_INTERVAL_S) if others else own_s)

    def _sought(self, *, now: float) -> list[Peer]:
        return [peer for peer in self._state.peers.values() if self.is_sought(peer, now=now)]


def _path_interval_s(peer: Peer) -> float:
    """Return how often to look for a peer: probes stay below a small part of what its path was seen to carry."""
    capacity_bps, rtt = peer.congestion.capacity_bps, peer.session.rtt
    unknown_s = rtt.min_s if rtt.has_sample else 0.0
    fair_s = 8 * PROBE_BYTES / (PROBE_SHARE * capacity_bps) if capacity_bps else unknown_s
    return min(max(PROBE_INTERVAL_S, fair_s), PROBE_RAREST_S)
