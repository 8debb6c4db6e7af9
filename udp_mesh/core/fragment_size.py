"""How large the datagrams of a message may be: as its paths want it, and as the wire format needs it."""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.settings import BROADCAST_NAME
from udp_mesh.core.state import NodeState

_LEAST_PAYLOAD_BYTES = 64


def datagram_bytes(state: NodeState, to: str, *, topic_bytes: int, size_bytes: int) -> int:
    """Return the largest datagram for a message to a peer or to all; at most what its carriers take.

    A message keeps its fragments for good, so what was published before a path became slow stays large.
    """
    overhead = wire.HEADER_BYTES + wire.DATA_BYTES
    if to == BROADCAST_NAME:
        most = state.broadcast_bytes
        if overhead + 1 + topic_bytes + size_bytes <= most:
            return most  # one broadcast for all
        peers = [peer for peer in state.peers.values() if peer.is_online]
    else:
        peers = [state.peers[to]] if to in state.peers else []
    most = min((state.packet_bytes(peer.path) for peer in peers), default=state.settings.packet_bytes)
    wanted = min((peer.congestion.datagram_bytes for peer in peers), default=most)
    needed = overhead + max(
        1 + topic_bytes + _LEAST_PAYLOAD_BYTES, -(-(size_bytes + topic_bytes) // wire.MAX_FRAGMENTS) + 1
    )
    return min(most, max(wanted, needed))
