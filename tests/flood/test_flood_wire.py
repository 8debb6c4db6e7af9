"""The flood's header, byte for byte."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.flood.wire import INNER_AT, Fault, Header, decode, encode, relayed

ENDS = bytes.fromhex("ffffffffffff024e4c000007")
INNER = bytes.fromhex("024e4d000003024e4d0000010800") + b"hello"
HEADER = Header(64, len(INNER), bytes.fromhex("024e4d000001"), 0x1234, 0x89ABCDEF)
# EtherType, version 1, hop limit 64, check, length 19, originator, epoch, sequence; the check by Python's crc_hqx and,
# independently, by hand with the polynomial 0x1021 from zero.
GOLDEN = "88b5 0140 {check:04x} 0013 024e4d000001 1234 89abcdef"

headers = st.builds(
    Header,
    st.integers(0, 255),
    st.just(len(INNER)),
    st.binary(min_size=6, max_size=6),
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFFFFFFFF),
)


def crc(data: bytes) -> int:
    """CRC-16/CCITT bit by bit."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


def test_golden_bytes() -> None:
    check = crc(bytes.fromhex("0013 024e4d000001 1234 89abcdef"))
    assert encode(HEADER, INNER) == bytes.fromhex(GOLDEN.format(check=check)) + INNER
    assert INNER_AT == 14 + 18


@given(headers)
def test_what_is_encoded_is_decoded_also_behind_padding(header: Header) -> None:
    frame = ENDS + encode(header, INNER)
    assert decode(frame) == header
    assert decode(frame + bytes(40)) == header


@given(headers, st.integers(0, 255))
def test_a_relay_changes_the_hop_limit_alone(header: Header, hop_limit: int) -> None:
    frame = ENDS + encode(header, INNER)
    assert decode(ENDS + relayed(frame, hop_limit)) == header._replace(hop_limit=hop_limit)
    assert relayed(frame, hop_limit)[4:] == frame[16:]


@given(headers, st.integers(16 * 8, 32 * 8 - 1))
def test_one_flipped_bit_where_duplicates_are_told_is_noticed(header: Header, bit: int) -> None:
    frame = bytearray(ENDS + encode(header, INNER))
    frame[bit // 8] ^= 1 << bit % 8
    assert decode(bytes(frame)) is Fault.CHECK


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (b"", Fault.TOO_SHORT),
        (ENDS + encode(HEADER, INNER)[:33], Fault.TOO_SHORT),
        (ENDS + b"\x08\x00" + encode(HEADER, INNER)[2:], Fault.OTHER_TYPE),
        (ENDS + encode(HEADER, INNER).replace(b"\x88\xb5\x01", b"\x88\xb5\x02", 1), Fault.VERSION),
        (ENDS + encode(HEADER._replace(length_bytes=len(INNER) + 1), INNER), Fault.LENGTH),
        (ENDS + encode(HEADER._replace(length_bytes=13), INNER), Fault.LENGTH),
    ],
)
def test_faults(frame: bytes, fault: Fault) -> None:
    assert decode(frame) is fault


@given(st.binary(max_size=100), st.booleans())
def test_any_bytes_are_a_header_or_a_fault(data: bytes, typed: bool) -> None:
    frame = ENDS + b"\x88\xb5\x01" + data if typed else data
    found = decode(frame)
    assert isinstance(found, Fault) or 14 <= found.length_bytes <= len(frame) - INNER_AT
