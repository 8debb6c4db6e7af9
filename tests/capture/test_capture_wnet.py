"""Frames of `mesh: wnet` for people, on wires and on the air."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from netlab.capture.describe import describe_frame
from netlab.capture.wnet import inner_frame
from wnet.core import wire
from wnet.io import dot11, radiotap

ENDS = bytes.fromhex("03574e657400 024e4c000003") + wire.ETHERTYPE
ARP = bytes.fromhex("ffffffffffff024e4d0000010806000108000604 0001024e4d0000010af00001 0000000000000af00003")
HOP = wire.Hop(bytes.fromhex("024e4c000001"), 9, (bytes.fromhex("024e4d000002"),))


def carried(kind: int, listing: bytes = b"", inner: bytes = ARP) -> bytes:
    tail = wire.tail_of(5, 7, inner)
    words = {"is_ack_wanted": True, "attempt": 1, "hop_limit": 31, "urgency": 4}
    return ENDS + wire.encode(kind, tail, listing=listing, **words)


def test_the_header_and_what_travels_inside() -> None:
    text = describe_frame(carried(wire.UNICAST), 1)
    header = "wnet unicast of 02:4e:4d:00:00:01 #7 hop limit 31, try 2"
    assert text == f"{header}: ARP who has 10.240.0.3, tell 10.240.0.1"
    listed = describe_frame(carried(wire.MULTICAST, wire.forward_list([HOP])), 1)
    assert "forward list of" in listed
    assert ", 02:4e:4c:00:00:01 for 1" in listed
    assert inner_frame(carried(wire.UNICAST), 14) == ARP
    nested = carried(wire.UNICAST, inner=carried(wire.UNICAST))
    assert describe_frame(nested, 1) == f"wnet unicast of 02:4e:4c:00:00:03 #7 hop limit 31, try 2 {len(nested)} B"


def test_control_frames_are_named() -> None:
    assert describe_frame(ENDS + bytes([wire.HELLO]) + bytes(40), 1) == "wnet HELLO 55 B"
    both = ENDS + wire.aggregate([bytes([wire.HELLO]) * 20, bytes([wire.ACK]) * 12])
    assert describe_frame(both, 1).startswith("wnet aggregate of 2 ")


def test_a_damaged_header_is_named() -> None:
    damaged = bytearray(carried(wire.UNICAST))
    damaged[16] ^= 1
    assert describe_frame(bytes(damaged), 1) == f"wnet unicast (check) {len(damaged)} B"


def test_on_the_air_signal_and_rate_come_first() -> None:
    heard = radiotap.encode_received(signal_dbm=-71, noise_dbm=-91, rate_bps=24_000_000) + dot11.encode(ENDS + b"\x11")
    assert describe_frame(heard, 127).startswith("-71 dBm 24 Mbit/s wnet HELLO")
    sent = radiotap.encode_transmit(6_000_000) + dot11.encode(ENDS + b"\x11")
    assert describe_frame(sent, 127).startswith("6 Mbit/s sent wnet HELLO")
    assert describe_frame(b"\0\0\x08\0\0\0\0\0beacon", 127) == "802.11 14 B"


@given(st.binary(max_size=80), st.sampled_from([1, 127]))
def test_any_bytes_are_described(tail: bytes, linktype: int) -> None:
    assert describe_frame(ENDS + tail, linktype)
