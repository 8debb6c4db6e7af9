"""A peer as it is shown: gathers what other modules keep."""

from __future__ import annotations

from udp_mesh.core.carriers import Path
from udp_mesh.core.peer import Peer
from udp_mesh.core.peer_status import PathStatus, PeerStatus
from udp_mesh.core.state import NodeState


def peer_status(state: NodeState, peer: Peer, *, now: float) -> PeerStatus:
    """Return what applications are told of a peer."""
    return PeerStatus(
        name=peer.name,
        online=peer.is_online,
        carrier=peer.path.carrier,
        address=peer.path.address,
        silent_for_s=now - peer.last_heard_s,
        srtt_s=peer.session.rtt.srtt_s if peer.session.rtt.has_sample else None,
        rate_bps=peer.congestion.rate_bps,
        cwnd_bytes=peer.congestion.cwnd_bytes,
        queue_delay_s=peer.congestion.queue_delay_s,
        queued_messages=len(peer.lane.transfers),
        queued_bytes=sum(t.message.size_bytes for t in peer.lane.transfers.values()),
        paths=tuple(
            PathStatus(
                known.path.carrier,
                known.path.address,
                _bridge(state, known.path),
                known.path == peer.path,
                now - known.heard_s,
                known.loss_ratio,
                state.rate_bps(known.path),
            )
            for known in peer.paths
        ),
    )


def _bridge(state: NodeState, path: Path) -> str:
    """Return the name of the bridge on a path; empty without one, its address if it is not known any more."""
    if not path.via:
        return ""
    direct = path._replace(via=0)
    return next((peer.name for peer in state.peers.values() if peer.path == direct), path.address)
