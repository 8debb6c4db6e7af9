"""The flood's header, between the Ethernet header of a member's frame and the whole Ethernet frame that travels inside.

======  =====  ===========================================================================
offset  bytes  meaning (big endian)
======  =====  ===========================================================================
0       1      version, 1
1       1      hop limit: how many transmissions are left, this one included
2       2      check: CRC-16/CCITT of everything below, up to the frame inside
4       2      length of the frame inside, in bytes (real Ethernet pads short frames)
6       6      originator: address of the mesh interface that the frame came from
12      2      epoch: differs after every start of the originator
14      4      sequence number of the originator in that epoch
18             the frame inside
======  =====  ===========================================================================

The check covers what duplicates are told by: one flipped bit in a sequence number would otherwise make everything that
follows look old. The hop limit is outside, so that relays need not compute it anew. Damage further inside is left to
the protocols there, as in any layer-2 mesh.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from enum import StrEnum
from typing import NamedTuple

from netlab.medium.meshes import FLOOD_HEADER_BYTES

#: Local Experimental EtherType 1 (IEEE 802, clause 9.2.3).
ETHERTYPE = 0x88B5
VERSION = 1
BROADCAST = b"\xff" * 6
ETHERNET_BYTES = 14

_TYPE = ETHERTYPE.to_bytes(2, "big")
_HEADER = struct.Struct("!BBHH6sHI")
_CHECKED = struct.Struct("!H6sHI")
_HOP_LIMIT_AT = ETHERNET_BYTES + 1
_CHECKED_AT = ETHERNET_BYTES + 4
INNER_AT = ETHERNET_BYTES + _HEADER.size
assert _HEADER.size == FLOOD_HEADER_BYTES


class Fault(StrEnum):
    """Why a frame is none of the flood's."""

    TOO_SHORT = "too_short"
    OTHER_TYPE = "other_type"
    VERSION = "version"
    CHECK = "check"
    LENGTH = "length"


class Header(NamedTuple):
    """What a frame's header says. ``length_bytes`` is that of the frame inside."""

    hop_limit: int
    length_bytes: int
    originator: bytes
    epoch: int
    sequence: int


def encode(header: Header, inner: bytes) -> bytes:
    """Return what follows the two addresses of a member's frame: EtherType, header and the frame inside."""
    checked = _CHECKED.pack(header.length_bytes, header.originator, header.epoch, header.sequence)
    return _TYPE + struct.pack("!BBH", VERSION, header.hop_limit, crc_hqx(checked, 0)) + checked + inner


def relayed(frame: bytes, hop_limit: int) -> bytes:
    """Return what follows the two addresses of ``frame``, with another hop limit."""
    return frame[12:_HOP_LIMIT_AT] + bytes((hop_limit,)) + frame[_HOP_LIMIT_AT + 1 :]


def decode(frame: bytes) -> Header | Fault:
    """Read the header of a member's frame, from its destination address on. Never raises.

    A frame without a fault holds at least an Ethernet header inside.
    """
    if len(frame) < INNER_AT + ETHERNET_BYTES:
        return Fault.TOO_SHORT
    if frame[12:14] != _TYPE:
        return Fault.OTHER_TYPE
    version, hop_limit, check, length, originator, epoch, sequence = _HEADER.unpack_from(frame, ETHERNET_BYTES)
    if version != VERSION:
        return Fault.VERSION
    if check != crc_hqx(frame[_CHECKED_AT:INNER_AT], 0):
        return Fault.CHECK
    if not ETHERNET_BYTES <= length <= len(frame) - INNER_AT:
        return Fault.LENGTH
    return Header(hop_limit, length, originator, epoch, sequence)
