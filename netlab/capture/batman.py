"""What a batman-adv frame says, in one line, and where the frame inside it begins. Source: linux/batadv_packet.h.

Never raises on a frame: one that is too short for its type is named by its type alone.
"""

from __future__ import annotations

import struct

ETHERTYPE = 0x4305
_TYPES = {
    0x00: "OGM",
    0x01: "broadcast",
    0x02: "coded",
    0x03: "ELP",
    0x04: "OGMv2",
    0x05: "multicast",
    0x40: "unicast",
    0x41: "fragment",
    0x42: "unicast",
    0x43: "ICMP",
    0x44: "TVLV",
}
_OGM, _BROADCAST, _ELP, _OGM2, _UNICAST, _UNICAST_4 = 0x00, 0x01, 0x03, 0x04, 0x40, 0x42
_OGM_BODY = struct.Struct("!2xBxI6s6xxB")  # ttl, sequence number, originator, transmit quality
_OGM2_BODY = struct.Struct("!2xBxI6s2xI")  # ttl, sequence number, originator, throughput in 100 kbit/s
_ELP_BODY = struct.Struct("!2x6sI")  # originator, sequence number
_INNER_AT = {_BROADCAST: 14, _UNICAST: 10, _UNICAST_4: 18}


def inner_offset(frame: bytes, start: int) -> int | None:
    """Where the whole Ethernet frame inside begins; None if there is none.

    Args:
        frame: A frame of type ``ETHERTYPE``.
        start: Where its payload begins.
    """
    header_bytes = _INNER_AT.get(frame[start]) if start < len(frame) else None
    return start + header_bytes if header_bytes and len(frame) >= start + header_bytes + 14 else None


def describe(frame: bytes, start: int) -> str:
    """Say what the batman-adv header is; of several routing messages in one frame, the first."""
    kind = frame[start] if start < len(frame) else -1
    text = f"batman-adv {_TYPES.get(kind, '')}".rstrip()
    body = memoryview(frame)[start:]
    if kind == _OGM and len(body) >= _OGM_BODY.size:
        ttl, sequence, originator, quality = _OGM_BODY.unpack_from(body)
        return f"{text} of {originator.hex(':')} #{sequence} tq {quality} ttl {ttl}"
    if kind == _OGM2 and len(body) >= _OGM2_BODY.size:
        ttl, sequence, originator, throughput = _OGM2_BODY.unpack_from(body)
        return f"{text} of {originator.hex(':')} #{sequence} {throughput / 10:g} Mbit/s ttl {ttl}"
    if kind == _ELP and len(body) >= _ELP_BODY.size:
        originator, sequence = _ELP_BODY.unpack_from(body)
        return f"{text} of {originator.hex(':')} #{sequence}"
    if kind in (_UNICAST, _UNICAST_4) and len(body) >= 10:
        return f"{text} to {bytes(body[4:10]).hex(':')}"
    return text
