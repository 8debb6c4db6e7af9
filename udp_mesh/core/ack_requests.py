"""The sending side of acknowledgements: which packets ask for one at once, and which may wait for later ones.

On a radio an acknowledgement is a frame as any other: it waits for its turn, may collide, and takes the airtime of a
seventh of a full packet. On slow paths the sender therefore spaces them: packets between say that theirs may wait.

Source: Li et al., "TACK: Improving Wireless Transport Performance by Taming Acknowledgments", SIGCOMM 2020, section 4.
What is lost or late is still told at once (:mod:`udp_mesh.core.acks`).
"""

from __future__ import annotations

from udp_mesh.core import wire

LEAST_PACKETS = 2


class AckRequests:
    """What was sent to one epoch of a peer since a packet last asked."""

    __slots__ = ("_bytes", "_packets")

    def __init__(self) -> None:
        self._packets = 0
        self._bytes = 0

    def flags(self, size_bytes: int, *, stalls: bool, repeats: bool, spacing_bytes: float) -> int:
        """Return the header flags of a packet that leaves.

        Args:
            size_bytes: Its size.
            stalls: Nothing follows before something is acknowledged, or nothing at all.
            repeats: It holds what was lost before.
            spacing_bytes: After how many an acknowledgement is worth its airtime; 0 leaves it to the receiver.
        """
        self._packets += 1
        self._bytes += size_bytes
        is_due = repeats or (self._bytes >= spacing_bytes and self._packets >= LEAST_PACKETS)
        if stalls or (spacing_bytes > 0 and is_due):
            self._packets = self._bytes = 0
            return wire.FLAG_ACK_NOW
        return wire.FLAG_ACK_LATER if spacing_bytes > 0 else 0
