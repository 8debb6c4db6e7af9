from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.layers.inet import ICMP, IP, TCP, UDP
from scapy.layers.l2 import ARP, Dot1Q, Ether

from netlab.capture.decoders import mesh_of, traffic_of, udp_of
from netlab.capture.describe import describe_frame
from udp_mesh.core import wire

ETHERNET = Ether(src="02:00:00:00:00:01", dst="02:00:00:00:00:02")
DATAGRAM = UDP(sport=8700, dport=8701) / b"hello"


@pytest.mark.parametrize(
    "frame",
    [
        ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2") / DATAGRAM,
        ETHERNET / Dot1Q(vlan=7) / IP(src="10.1.0.1", dst="10.1.0.2") / DATAGRAM,
        ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2", options=b"\x01\x01\x01\x01") / DATAGRAM,
        ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2") / DATAGRAM / (b"\0" * 0),
    ],
    ids=["plain", "vlan", "options", "exact"],
)
def test_udp_is_found_where_scapy_put_it(frame: Ether) -> None:
    found = udp_of(bytes(frame) + bytes(9))  # Ethernet pads short frames
    assert found is not None
    assert (found.source, found.destination) == ("10.1.0.1", "10.1.0.2")
    assert (found.source_port, found.destination_port, bytes(found.payload)) == (8700, 8701, b"hello")


@pytest.mark.parametrize(
    "frame",
    [
        ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2", flags="MF") / DATAGRAM,
        ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2", frag=3) / DATAGRAM,
        ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2") / TCP(),
        ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2") / UDP(sport=1, dport=2, len=900) / b"short",
        ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2") / UDP(sport=1, dport=2, len=3),
        ETHERNET / ARP(),
    ],
    ids=["first fragment", "later fragment", "tcp", "length too long", "length too short", "arp"],
)
def test_what_is_no_whole_datagram_is_none(frame: Ether) -> None:
    assert udp_of(bytes(frame)) is None
    assert udp_of(bytes(ETHERNET / IP() / DATAGRAM), linktype=101) is None


@given(st.binary(max_size=200))
def test_no_bytes_make_the_decoders_raise(tail: bytes) -> None:
    head = bytes(ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2") / DATAGRAM)
    for frame in (tail, head[:12] + tail, head[:14] + tail, head[:40] + tail, bytes(12) + b"\x08\x06" + tail):
        found = udp_of(frame)
        if found is not None:
            mesh_of(found)
            traffic_of(found.payload)
        assert describe_frame(frame, 1)


def mesh_frame() -> bytes:
    payload = struct.pack("<4sHIQ", b"NLT1", 3, 17, 123456789) + b"x" * 20
    header = wire.encode_header(epoch=5 << 32 | 9, destination_tag=4, packet_number=77, flags=0)
    data = wire.encode_data_header(
        message_id=41, priority=2, index=0, count=3, payload_bytes=len(payload), topic=b"map"
    )
    return bytes(ETHERNET / IP(src="10.1.0.1", dst="10.1.0.2") / UDP(sport=8700, dport=8700)) + header + data + payload


def test_mesh_fragments_and_traffic_headers_are_read() -> None:
    frame = bytearray(mesh_frame())
    length = len(frame) - 14
    struct.pack_into("!H", frame, 16, length)
    struct.pack_into("!H", frame, 38, length - 20)
    datagram = udp_of(bytes(frame))
    assert datagram is not None
    mesh = mesh_of(datagram)
    assert mesh is not None
    (piece,) = mesh.fragments
    assert (mesh.packet_number, piece.message_id, piece.priority, piece.fragment_count) == (77, 41, 2, 3)
    assert traffic_of(piece.payload) == (3, 17, 123456789)
    text = describe_frame(bytes(frame), 1)
    assert text == "10.1.0.1 > 10.1.0.2 mesh #77 data p2 m41 1/3 map s3#17 38 B"


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (ETHERNET / ARP(op=1, psrc="10.0.0.1", pdst="10.0.0.2"), "ARP who has 10.0.0.2, tell 10.0.0.1"),
        (ETHERNET / ARP(op=2, psrc="10.0.0.1", hwsrc="02:00:00:00:00:07"), "ARP 10.0.0.1 is at 02:00:00:00:00:07"),
        (ETHERNET / IP(src="10.0.0.1", dst="10.0.0.2") / ICMP(), "ICMP 10.0.0.1 > 10.0.0.2 echo request 42 B"),
        (ETHERNET / IP(src="10.0.0.1", dst="10.0.0.2") / DATAGRAM, "UDP 10.0.0.1:8700 > 10.0.0.2:8701 5 B"),
        (Ether(type=0x4305) / b"1234", "batman-adv 18 B"),
    ],
)
def test_other_frames_are_named(frame: Ether, text: str) -> None:
    assert describe_frame(bytes(frame), 1) == text
