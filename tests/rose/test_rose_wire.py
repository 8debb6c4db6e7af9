"""The header: golden bytes, and that nothing from the network raises."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rose.core.addressing import ServiceId
from rose.core.wire import HEADER_BYTES, PARTS_MAX, Fault, Flag, Header, Kind, decode, encode

SENDER = ServiceId.parse("10.0.0.114/0.2")
HEADER = Header(
    kind=Kind.PUBLICATION,
    sender=SENDER,
    epoch_ns=0x1122334455667788,
    sequence=5,
    published_ns=0x1122334455667799,
    type_id=b"\xde\xad\xbe\xef",
    type_version=3,
    flags=Flag.SLICED,
    part=1,
    parts=2,
)
GOLDEN = bytes.fromhex(
    "5253 01 01 02 00 0001 0002"  # magic, version, publication, sliced, no key, part 1 of 2
    "00000000000000000000ffff0a000072 0000 0002"  # ::ffff:10.0.0.114, robot 0, service 2
    "1122334455667788 0000000000000005 1122334455667799"
    "deadbeef 03 00"
)
headers = st.builds(
    Header,
    kind=st.sampled_from(Kind),
    sender=st.sampled_from([SENDER, ServiceId.parse("fd00::72/65535.65535")]),
    epoch_ns=st.integers(0, (1 << 64) - 1),
    sequence=st.integers(0, (1 << 64) - 1),
    published_ns=st.integers(0, (1 << 64) - 1),
    type_id=st.binary(min_size=4, max_size=4),
    type_version=st.integers(0, 255),
    flags=st.sampled_from([Flag(0), Flag.SLICED, Flag.REFUSED]),
    key_id=st.integers(0, 255),
    part=st.just(0),
    parts=st.integers(1, PARTS_MAX),
)


def test_golden_bytes() -> None:
    assert encode(HEADER) == GOLDEN
    assert len(GOLDEN) == HEADER_BYTES
    assert decode(GOLDEN + b"payload") == HEADER


@given(headers)
def test_headers_are_read_back(header: Header) -> None:
    assert decode(encode(header)) == header


@given(st.one_of(st.binary(max_size=200), st.binary(max_size=150).map(lambda tail: b"RS\x01" + tail)))
def test_no_bytes_raise(datagram: bytes) -> None:
    assert isinstance(decode(datagram), Header | Fault)


@given(st.integers(0, HEADER_BYTES - 1), st.integers(0, 255))
def test_no_changed_byte_raises(place: int, value: int) -> None:
    changed = bytearray(GOLDEN)
    changed[place] = value
    assert isinstance(decode(bytes(changed)), Header | Fault)


@pytest.mark.parametrize(
    ("place", "value", "fault"),
    [
        (0, 0x00, Fault.FOREIGN),
        (2, 2, Fault.VERSION),
        (3, 9, Fault.MALFORMED),  # kind
        (4, 0x80, Fault.MALFORMED),  # flag
        (7, 2, Fault.MALFORMED),  # part 2 of 2
        (25, 0xFF, Fault.MALFORMED),  # host ends with 255
        (27, 32, Fault.MALFORMED),  # robot 32 over IPv4
    ],
)
def test_faults_are_told_apart(place: int, value: int, fault: Fault) -> None:
    changed = bytearray(GOLDEN)
    changed[place] = value
    assert decode(bytes(changed)) is fault


def test_what_is_cut_short_is_told_from_what_is_foreign() -> None:
    assert decode(GOLDEN[:-1]) is Fault.TRUNCATED
    assert decode(b"hello") is Fault.FOREIGN
    sealed = bytearray(GOLDEN)
    sealed[4] |= Flag.SEALED
    assert decode(bytes(sealed) + bytes(15)) is Fault.TRUNCATED
