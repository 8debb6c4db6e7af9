"""Sealed datagrams on the wire: what stands in the clear before the encrypted frames (docs/wire.md)."""

from __future__ import annotations

import struct
from typing import NamedTuple

from udp_mesh.core import wire
from udp_mesh.core.packets import BadDatagram
from udp_mesh.core.wire_links import FLAG_BRIDGED

TAG_BYTES = 16
_SEAL = struct.Struct("!BBHI")  # key id, series, number (48 bits)
_EPOCH = struct.Struct("!Q")
_NONCE = struct.Struct("!IQ")  # 0, number
_FLAGS_AT = 3
_EPOCH_AT = 4
CLEAR_BYTES = wire.HEADER_BYTES + _SEAL.size
_OPENING = wire.MAGIC + bytes([wire.VERSION])
_LOW_32 = 0xFFFFFFFF
assert _SEAL.size + TAG_BYTES == wire.SEAL_BYTES


class SealHeader(NamedTuple):
    """``epoch`` and ``series`` name the sender and one of its carriers; ``number`` counts its datagrams, from 0."""

    epoch: int
    key_id: int
    series: int
    number: int


def encode_clear(header: bytes, *, key_id: int, series: int, number: int) -> bytes:
    """Return what precedes the encrypted frames of a datagram whose plain header is given; it is authenticated."""
    clear = bytearray(header)
    clear[_FLAGS_AT] |= wire.FLAG_SEALED
    return bytes(clear) + _SEAL.pack(key_id, series, number >> 32, number & _LOW_32)


def decode_clear(datagram: memoryview) -> SealHeader | BadDatagram:
    """Return the seal's own header, or why there is none. Never raises."""
    if len(datagram) < wire.HEADER_BYTES or datagram[: len(_OPENING)] != _OPENING:
        reason = wire.decode(datagram)
        return reason if isinstance(reason, BadDatagram) else BadDatagram.FOREIGN
    if not datagram[_FLAGS_AT] & wire.FLAG_SEALED:
        return BadDatagram.UNSEALED
    if len(datagram) < CLEAR_BYTES + TAG_BYTES:
        return BadDatagram.TRUNCATED
    key_id, series, high, low = _SEAL.unpack_from(datagram, wire.HEADER_BYTES)
    (epoch,) = _EPOCH.unpack_from(datagram, _EPOCH_AT)
    return SealHeader(epoch, key_id, series, high << 32 | low)


def plain_header(datagram: memoryview) -> bytes:
    """Return the header as it was before the datagram was sealed."""
    header = bytearray(datagram[: wire.HEADER_BYTES])
    header[_FLAGS_AT] &= ~wire.FLAG_SEALED
    return bytes(header)


def authenticated(datagram: memoryview) -> memoryview | bytes:
    """Return the clear bytes as the sender has authenticated them: without the mark that a bridge may have added."""
    clear = datagram[:CLEAR_BYTES]
    if not clear[_FLAGS_AT] & FLAG_BRIDGED:
        return clear
    unmarked = bytearray(clear)
    unmarked[_FLAGS_AT] &= ~FLAG_BRIDGED
    return bytes(unmarked)


def nonce(number: int) -> bytes:
    """Return the 12 bytes that are never used twice under one epoch's key."""
    return _NONCE.pack(0, number)
