"""What bridges put on the wire: the LINK frame and the mark of a datagram that was passed on (docs/wire.md)."""

from __future__ import annotations

import struct

from udp_mesh.core.packets import Link

TYPE_LINK = 16
FLAG_BRIDGED = 0x08  # a bridge has passed it on; never passed on again
LINK_HEAD = struct.Struct("!BBHIBB")  # type, number, longest datagram, bit/s, rounds, tags
TAG = struct.Struct("!I")
_FLAGS_AT = 3


def encode_link(link: Link) -> bytes:
    """Return a frame that says whom a bridge reaches by one of its carriers, at most 255 tags."""
    mtu_bytes, rate_bps = min(link.mtu_bytes, 0xFFFF), min(link.rate_bps, 0xFFFFFFFF)
    head = LINK_HEAD.pack(TYPE_LINK, link.number, mtu_bytes, rate_bps, min(link.rounds, 255), len(link.tags))
    return head + b"".join(map(TAG.pack, link.tags))


def mark_bridged(datagram: bytes | memoryview) -> bytes:
    """Return a datagram as a bridge passes it on; the mark is no part of what a key authenticates."""
    marked = bytearray(datagram)
    marked[_FLAGS_AT] |= FLAG_BRIDGED
    return bytes(marked)
