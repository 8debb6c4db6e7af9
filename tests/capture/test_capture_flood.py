"""Frames of `mesh: flood` for people."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from netlab.capture.describe import describe_frame
from netlab.capture.flood import inner_offset
from netlab.flood.wire import Header, encode

ENDS = bytes.fromhex("ffffffffffff024e4c000003")
ORIGINATOR = bytes.fromhex("024e4d000001")
ARP = bytes.fromhex("ffffffffffff024e4d0000010806000108000604 0001024e4d0000010af00001 0000000000000af00003")


def flooded(inner: bytes) -> bytes:
    return ENDS + encode(Header(63, len(inner), ORIGINATOR, 5, 7), inner)


def test_the_header_and_what_travels_inside() -> None:
    text = "flood of 02:4e:4d:00:00:01 #7 hop limit 63"
    assert describe_frame(flooded(ARP), 1) == f"{text}: ARP who has 10.240.0.3, tell 10.240.0.1"
    assert describe_frame(flooded(flooded(ARP)), 1) == f"{text} 106 B", "no descent into what nobody nests"
    assert inner_offset(flooded(ARP)) == 32


def test_a_damaged_header_is_named() -> None:
    damaged = bytearray(flooded(ARP))
    damaged[20] ^= 1
    assert describe_frame(bytes(damaged), 1) == "flood? (check) 74 B"


@given(st.binary(max_size=80))
def test_any_bytes_are_described(tail: bytes) -> None:
    assert describe_frame(ENDS + b"\x88\xb5" + tail, 1).startswith("flood")
