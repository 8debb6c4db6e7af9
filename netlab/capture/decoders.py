"""What is inside a captured frame: Ethernet, ARP, IPv4, UDP and ICMP by ``struct``, udp_mesh by its own decoder.

Never raises on a frame: what it does not understand ends the decoding, and the layers above stay None.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from netlab.capture import batman, flood, wnet
from udp_mesh.core.envelope import decode as decode_envelope
from udp_mesh.core.wire import DATA_FLAG_ENVELOPE, DataFragment, Dissection, dissect

LINKTYPE_ETHERNET = 1
LINKTYPE_RADIOTAP = 127
_ETHERTYPE_IPV4 = 0x0800
_VLAN_TYPES = (0x8100, 0x88A8)
_IPV4 = struct.Struct("!BxHxxHxBxx4s4s")  # version and header length, total length, fragment bits, protocol, ends
_UDP = struct.Struct("!HHH")
_PROTOCOL_UDP = 17
_FRAGMENTED = 0x3FFF  # more-fragments flag and offset
TRAFFIC_MAGIC = b"NLT1"
_TRAFFIC = struct.Struct("<4sHIQ")


class UdpPacket(NamedTuple):
    """A whole UDP datagram over IPv4 over Ethernet."""

    source: str
    source_port: int
    destination: str
    destination_port: int
    payload: memoryview


class TrafficHeader(NamedTuple):
    """The first bytes of every payload of netlab's own traffic processes."""

    stream: int
    seq: int
    published_ns: int


class LayerTwoMesh(NamedTuple):
    """A mesh below IP. ``inner_offset`` of (frame, where its payload begins): where the whole Ethernet frame inside
    begins, None if there is none."""

    name: str
    inner_offset: Callable[[bytes, int], int | None]


MESHES = {
    batman.ETHERTYPE: LayerTwoMesh("batman-adv", batman.inner_offset),
    flood.ETHERTYPE: LayerTwoMesh("flood", lambda frame, _start: flood.inner_offset(frame)),
    wnet.ETHERTYPE: LayerTwoMesh("wnet", wnet.inner_offset),
}


def ethertype(frame: bytes | memoryview) -> tuple[int, int]:
    """Return (EtherType behind any VLAN tags, offset of the payload); (0, length) of a frame that is too short."""
    offset = 12
    while len(frame) >= offset + 2:
        kind = frame[offset] << 8 | frame[offset + 1]
        if kind not in _VLAN_TYPES:
            return kind, offset + 2
        offset += 4
    return 0, len(frame)


def peel(frame: bytes) -> tuple[str, bytes]:
    """Take the headers of layer-2 meshes off a frame.

    Returns:
        The outermost mesh's name, empty if there is none, and the Ethernet frame inside all of them, or what is left
        where nothing whole is inside.
    """
    name = ""
    while (mesh := MESHES.get(ethertype(frame)[0])) is not None:
        name = name or mesh.name
        inner = mesh.inner_offset(frame, ethertype(frame)[1])
        if inner is None:
            break
        frame = frame[inner:]
    return name, frame


def udp_of(frame: bytes, linktype: int = LINKTYPE_ETHERNET) -> UdpPacket | None:
    """Return the UDP datagram in a frame; None for anything else, IP fragments and cut frames included."""
    if linktype != LINKTYPE_ETHERNET:
        return None
    kind, start = ethertype(frame)
    if kind != _ETHERTYPE_IPV4 or len(frame) < start + 28:
        return None
    first, total_length, fragment, protocol, source, destination = _IPV4.unpack_from(frame, start)
    udp = start + (first & 0x0F) * 4
    if first >> 4 != 4 or protocol != _PROTOCOL_UDP or fragment & _FRAGMENTED or len(frame) < udp + 8:
        return None
    source_port, destination_port, length = _UDP.unpack_from(frame, udp)
    if length < 8 or udp + length > len(frame) or udp + length > start + total_length:
        return None
    payload = memoryview(frame)[udp + 8 : udp + length]
    return UdpPacket(_dotted(source), source_port, _dotted(destination), destination_port, payload)


def mesh_of(datagram: UdpPacket) -> Dissection | None:
    """Return the udp_mesh datagram inside; None for foreign bytes."""
    return dissect(datagram.payload)


def traffic_of(payload: bytes | memoryview) -> TrafficHeader | None:
    """Return the header that netlab's traffic processes put first into a message; None for other messages."""
    if len(payload) < _TRAFFIC.size:
        return None
    magic, stream, seq, published_ns = _TRAFFIC.unpack_from(payload)
    return TrafficHeader(stream, seq, published_ns) if magic == TRAFFIC_MAGIC else None


def traffic_in(fragment: DataFragment) -> TrafficHeader | None:
    """As :func:`traffic_of`, of a message's first fragment, behind its envelope if it has one; None for any other."""
    if fragment.topic is None:
        return None
    if not fragment.flags & DATA_FLAG_ENVELOPE:
        return traffic_of(fragment.payload)
    opened = decode_envelope(fragment.payload)
    return traffic_of(opened[1]) if opened is not None else None


@lru_cache(maxsize=1024)
def _dotted(address: bytes) -> str:
    return f"{address[0]}.{address[1]}.{address[2]}.{address[3]}"
