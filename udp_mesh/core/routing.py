"""Turns a peer to another path, with what follows from it for its queue. When, :mod:`udp_mesh.core.paths` decides."""

from __future__ import annotations

from udp_mesh.core.carriers import Path
from udp_mesh.core.events import DropReason, PathChanged
from udp_mesh.core.outbox import Outbox
from udp_mesh.core.paths import STALE_AT_LEAST_S, STALE_BEACONS
from udp_mesh.core.peer import Peer
from udp_mesh.core.state import NodeState


class Router:
    """Every peer's path."""

    def __init__(self, state: NodeState, outbox: Outbox) -> None:
        self._state = state
        self._outbox = outbox

    def heard(self, peer: Peer, path: Path, *, now: float) -> None:
        """Note a datagram of a known epoch, and by which path it came."""
        peer.paths.heard(path, now=now)
        if path == peer.path:
            return
        if (path.carrier, path.via) == (peer.path.carrier, peer.path.via) or not peer.is_online:
            self._use(peer, path, now=now)
        else:
            self._choose(peer, now=now)

    def on_broadcast(self, peer: Peer, path: Path, number: int, *, now: float) -> None:
        """Note that a broadcast came this way: its number tells what the path loses."""
        peer.paths.heard(path, now=now).on_broadcast(number)
        self._choose(peer, now=now)

    def on_probe_timeout(self, peer: Peer, *, now: float) -> None:
        """Turn to another path when an acknowledgement is overdue: the probe leaves there."""
        other = peer.paths.alternative(peer.path, self._state.carriers, stale_s=_stale_s(peer), now=now)
        if other is not None:
            self._use(peer, other, now=now)

    def _choose(self, peer: Peer, *, now: float) -> None:
        best = peer.paths.best(peer.path, self._state.carriers, stale_s=_stale_s(peer), now=now)
        if best != peer.path:
            self._use(peer, best, now=now)

    def _use(self, peer: Peer, path: Path, *, now: float) -> None:
        state = self._state
        state.events.append(PathChanged(now, peer.name, *peer.path[:2], *path[:2]))
        before = state.packet_bytes(peer.path)
        peer.path = path
        room = state.packet_bytes(path)
        if room != before:
            peer.congestion = state.new_congestion(path, now=now)
            peer.pacer.reset()
        if room < before:
            self._refit(peer, room, now=now)

    def _refit(self, peer: Peer, room: int, *, now: float) -> None:
        """Cut messages anew whose datagrams this path cannot carry.

        One that has left whole may have arrived whole: under a new id it would arrive twice. It ends as unknown.
        """
        for transfer in list(peer.lane.transfers.values()):
            if transfer.message.largest_bytes <= room:
                continue
            if transfer.is_fully_sent:
                self._outbox.drop(transfer, DropReason.PATH_TOO_SMALL, now=now)
            else:
                self._outbox.start_over(transfer, now=now)


def _stale_s(peer: Peer) -> float:
    return max(STALE_AT_LEAST_S, STALE_BEACONS * peer.beacon_interval_s)
