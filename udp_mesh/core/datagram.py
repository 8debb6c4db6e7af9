"""What the core hands out for sending."""

from __future__ import annotations

from typing import NamedTuple

from udp_mesh.core.peer import Path

CONTROL_PRIORITY = 0


class Datagram(NamedTuple):
    """Bytes for one path: one datagram, or with ``segment_bytes`` several of that length (the last may be shorter).

    Consecutive ones for the same path and of one length may leave in one system call. ``priority`` is that of the most
    urgent message inside; what keeps the mesh together (acknowledgements, beacons, probes) has ``CONTROL_PRIORITY``.
    """

    path: Path
    data: bytes
    segment_bytes: int = 0
    priority: int = CONTROL_PRIORITY

    def segments(self) -> list[bytes]:
        """Return the datagrams one by one."""
        size = self.segment_bytes or max(1, len(self.data))
        return [self.data[at : at + size] for at in range(0, len(self.data), size)]
