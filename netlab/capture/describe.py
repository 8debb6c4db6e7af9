"""One line of text for a captured frame, for people."""

from __future__ import annotations

import struct

from netlab.capture import batman, flood, rose, wnet
from netlab.capture.decoders import (
    LINKTYPE_ETHERNET,
    LINKTYPE_RADIOTAP,
    MESHES,
    ethertype,
    mesh_of,
    traffic_of,
    udp_of,
)
from udp_mesh.core.wire import Dissection
from wnet.io import dot11, radiotap

_ETHERTYPES = {0x0806: "ARP", 0x86DD: "IPv6", 0x88CC: "LLDP"}
_PROTOCOLS = {1: "ICMP", 2: "IGMP", 6: "TCP", 17: "UDP", 58: "ICMPv6"}
_ICMP = {0: "echo reply", 3: "unreachable", 8: "echo request", 11: "time exceeded"}


def describe_frame(frame: bytes, linktype: int) -> str:
    """Say in one line what a frame is."""
    if linktype == LINKTYPE_RADIOTAP:
        return _on_the_air(frame)
    if linktype != LINKTYPE_ETHERNET:
        return f"linktype {linktype}"
    datagram = udp_of(frame)
    if datagram is None:
        return _below_udp(frame)
    ends = f"{datagram.source}:{datagram.source_port} > {datagram.destination}:{datagram.destination_port}"
    mesh = mesh_of(datagram)
    if mesh is None:
        service = rose.header_of(datagram.payload)
        told = f" {rose.describe(service)}" if service is not None else ""
        return f"UDP {ends}{told} {len(datagram.payload)} B"
    return f"{datagram.source} > {datagram.destination} mesh #{mesh.packet_number} {describe_mesh(mesh)}"


def _on_the_air(frame: bytes) -> str:
    """Describe what a radio in monitor mode sent or heard, and how."""
    header = radiotap.decode(frame)
    inner = None if header is None else dot11.decode(frame, header.length_bytes)
    if header is None or inner is None:
        return f"802.11 {len(frame)} B"
    told = [f"{header.signal_dbm:g} dBm"] if header.signal_dbm is not None else []
    told += [f"{header.rate_bps / 1e6:g} Mbit/s"] if header.rate_bps else []
    told += ["sent"] if header.is_echo else []
    return " ".join((*told, describe_frame(inner, LINKTYPE_ETHERNET)))


def describe_mesh(mesh: Dissection) -> str:
    """Say in one line what a udp_mesh datagram carries."""
    parts = []
    for fragment in mesh.fragments:
        where = f"{fragment.fragment_index + 1}/{fragment.fragment_count}"
        text = f"data p{fragment.priority} m{fragment.message_id} {where}"
        if fragment.topic is not None:
            text += f" {fragment.topic}"
            header = traffic_of(fragment.payload)
            text += f" s{header.stream}#{header.seq}" if header else ""
        parts.append(f"{text} {len(fragment.payload)} B")
    for ack in mesh.acks:
        ranges = ",".join(str(first) if first == last else f"{first}-{last}" for first, last in ack.ranges[:4])
        parts.append(f"ack {ranges}{',..' if len(ack.ranges) > 4 else ''}")
    parts += [f"beacon {beacon.name}" for beacon in mesh.beacons]
    parts += [f"probe for {len(mesh.probes)}"] if mesh.probes else []
    parts += [f"floor {floor}" for floor in mesh.floors]
    parts += [f"purged m{message_id}" for message_id in mesh.purged]
    parts += ["ping"] if mesh.pings else []
    parts += [f"link {link.number} to {len(link.tags)}" for link in mesh.links]
    text = "; ".join(parts) or "empty"
    return f"bridged {text}" if mesh.is_bridged else text


def _below_udp(frame: bytes) -> str:
    kind, start = ethertype(frame)
    if kind in MESHES:
        return _mesh(frame, kind, start)
    if kind == 0x0806 and len(frame) >= start + 28:
        return _arp(frame, start)
    if kind != 0x0800 or len(frame) < start + 20:
        return _ETHERTYPES.get(kind, f"EtherType {kind:#06x}") + f" {len(frame)} B"
    protocol = frame[start + 9]
    source, destination = frame[start + 12 : start + 16], frame[start + 16 : start + 20]
    text = f"{_PROTOCOLS.get(protocol, f'IP protocol {protocol}')} {_dotted(source)} > {_dotted(destination)}"
    inner = start + (frame[start] & 0x0F) * 4
    if protocol == 1 and len(frame) > inner:
        text += f" {_ICMP.get(frame[inner], f'type {frame[inner]}')}"
    return f"{text} {len(frame)} B"


def _mesh(frame: bytes, kind: int, start: int) -> str:
    """Describe a mesh's frame by its header and by what travels inside."""
    if kind == batman.ETHERTYPE:
        header, inner = batman.describe(frame, start), _from(frame, batman.inner_offset(frame, start))
    elif kind == flood.ETHERTYPE:
        header, inner = flood.describe(frame), _from(frame, flood.inner_offset(frame))
    else:
        header, inner = wnet.describe(frame, start), wnet.inner_frame(frame, start)
    if inner is None or ethertype(inner)[0] in MESHES:  # nobody nests them; no endless descent
        return f"{header} {len(frame)} B"
    return f"{header}: {describe_frame(inner, LINKTYPE_ETHERNET)}"


def _from(frame: bytes, offset: int | None) -> bytes | None:
    return None if offset is None else frame[offset:]


def _arp(frame: bytes, start: int) -> str:
    operation, source, target = struct.unpack_from("!6xH6x4s6x4s", frame, start)
    if operation == 1:
        return f"ARP who has {_dotted(target)}, tell {_dotted(source)}"
    return f"ARP {_dotted(source)} is at {frame[start + 8 : start + 14].hex(':')}"


def _dotted(address: bytes) -> str:
    return ".".join(map(str, address))
