"""Generic netlink: finding a family by its name, encoding its messages. Knows no family's meaning.

Source: linux/genetlink.h. Sockets are :class:`~netlab.kernel.netlink.NetlinkSocket` of protocol ``GENERIC``.
"""

from __future__ import annotations

import struct

from netlab.kernel.netlink import HEADER, NetlinkSocket, attributes

GENERIC = 16  # NETLINK_GENERIC
NLM_F_REQUEST = 0x1
NLM_F_DUMP = 0x300
#: What stands between a generic message's header and its attributes: command, version, reserved.
GENERIC_HEADER = struct.Struct("=BBH")
ATTRIBUTES_AT = HEADER.size + GENERIC_HEADER.size
_NESTED = 0x8000
_CONTROLLER = 0x10  # GENL_ID_CTRL
_GET_FAMILY = 3
_FAMILY_ID, _FAMILY_NAME = 1, 2
_ATTRIBUTE = struct.Struct("=HH")


def attribute(kind: int, value: bytes = b"") -> bytes:
    """Encode one attribute, padded; without a value it is a flag."""
    return _ATTRIBUTE.pack(_ATTRIBUTE.size + len(value), kind) + value + bytes(-len(value) % 4)


def number(kind: int, value: int) -> bytes:
    """Encode a 32-bit attribute; negative values as two's complement."""
    return attribute(kind, struct.pack("=I", value & 0xFFFFFFFF))


def text(kind: int, value: str) -> bytes:
    """Encode a zero-terminated text."""
    return attribute(kind, value.encode() + b"\0")


def nested(kind: int, *parts: bytes) -> bytes:
    """Encode an attribute that holds attributes."""
    return attribute(kind | _NESTED, b"".join(parts))


def message(family: int, command: int, *parts: bytes, flags: int = 0, version: int = 1) -> bytes:
    """Encode one request of a family; sequence numbers are the socket's business."""
    body = GENERIC_HEADER.pack(command, version, 0) + b"".join(parts)
    return HEADER.pack(HEADER.size + len(body), family, NLM_F_REQUEST | flags, 0, 0) + body


def family_id(sock: NetlinkSocket, name: str) -> int:
    """Return the number by which this kernel knows the family ``name``.

    Raises:
        NetlinkError: ENOENT where the kernel has no such family.
    """
    answer = sock.query(message(_CONTROLLER, _GET_FAMILY, text(_FAMILY_NAME, name)))
    (number_,) = struct.unpack("=H", attributes(answer, ATTRIBUTES_AT)[_FAMILY_ID])
    return int(number_)
