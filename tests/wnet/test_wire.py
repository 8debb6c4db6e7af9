"""Frames as bytes: what is written is read again, golden bytes, and decoders that bear anything."""

from __future__ import annotations

from binascii import crc_hqx

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wnet.core import wire, wire_control
from wnet.core.events import Drop
from wnet.core.wire import Hop
from wnet.core.wire_control import Ack, Attributes, Heard, Hello, Incoming, NodeInfo, Topology

A, B, C = (bytes((2, 0, 0, 0, 0, n)) for n in (1, 2, 3))
INNER = B + A + b"\x08\x00" + b"payload"
macs = st.binary(min_size=6, max_size=6)
ratios = st.integers(0, 254).map(lambda n: n / 255)
attributes = st.builds(
    Attributes,
    ratios,
    st.none() | st.integers(-127, 127).map(float),
    st.none() | st.integers(1, 160).map(lambda n: round(1000 * 2 ** (n / 8))),
)
infos = st.builds(
    NodeInfo,
    st.integers(0, 255).map(lambda n: n / 255),
    st.lists(st.binary(min_size=4, max_size=4), max_size=16).map(tuple),
    st.lists(macs, max_size=16).map(tuple),
)
heards = st.builds(
    Heard,
    macs,
    st.integers(0, 2**32 - 1),
    st.integers(0, 15),
    st.integers(0, 15),
    st.integers(0, 15),
    st.booleans(),
    st.booleans(),
    attributes,
    st.none() | attributes,
)


def test_a_unicast_frame_has_these_bytes() -> None:
    tail = wire.tail_of(0x01020304, 0x0A0B0C0D, INNER)
    body = wire.encode(wire.UNICAST, tail, is_ack_wanted=True, attempt=2, hop_limit=9, urgency=6, sequence=0x1122)
    before, after = "14050906", "001511220102030" + "40a0b0c0d"
    checked = bytes.fromhex(before + "0000" + after) + INNER[:12]
    assert body.hex() == before + f"{crc_hqx(checked, 0):04x}" + after + INNER.hex()
    assert wire.HEADER_BYTES == 18


def test_a_hello_has_these_bytes() -> None:
    info = NodeInfo(1.0, (bytes((10, 0, 0, 1)),), (bytes.fromhex("01005e010203"),))
    link = Heard(B, 0x11223344, 2, 1, 5, True, True, Attributes(51 / 255, -3.0, 1_000_000), None)
    body = wire_control.encode_hello(Hello(A, 0x01020304, 1, 0x0506, 0.1, 0x0708090A, 0.2, True, info, (link,)))
    before, after = "1101", "0133ff" + A.hex() + "01020304" + "0506" + "0064" + "0708090a"
    after += "0101" + "0a000001" + "01005e010203" + "0001"
    after += B.hex() + "11223344" + "21" + "c5" + "33fd50" + "ff8000"
    check = crc_hqx(bytes.fromhex(before + "0000" + after), 0)
    assert body.hex() == before + f"{check:04x}" + after


def test_a_tc_and_an_acknowledgement_have_these_bytes() -> None:
    link = Incoming(B, 5, Attributes(0.0, None, None))
    inner = wire_control.encode_tc(Topology(A, 10.0, NodeInfo(0.0, (), ()), (link,)))
    before, after = "ff" * 6 + A.hex(), "000a" + "0000" + "0001" + B.hex() + "05" + "008000"
    assert inner.hex() == before + f"{crc_hqx(bytes.fromhex(before + '0000' + after), 0):04x}" + after
    ack = wire_control.encode_ack(Ack(0x0102, 1, 0x80000001))
    assert ack.hex() == "1201" + f"{crc_hqx(bytes.fromhex('12010000' + '010280000001'), 0):04x}" + "010280000001"


@pytest.mark.parametrize("padding", [0, 30])
def test_data_is_read_as_it_was_written(padding: int) -> None:
    tail = wire.tail_of(7, 8, INNER)
    hops = (Hop(A, 1, (B, C)), Hop(B, 65535, (A,)))
    body = wire.encode(
        wire.MULTICAST, tail, is_ack_wanted=True, attempt=1, hop_limit=3, urgency=2, listing=wire.forward_list(hops)
    )
    assert wire.decode(body + bytes(padding)) == wire.Data(wire.MULTICAST, True, 1, 3, 2, 0, hops, (), tail)
    assert wire.key_of(tail) == tail[:20]
    assert (wire.destination_of(tail), wire.source_of(tail), wire.origin_of(tail)) == (B, A, (7, 8))


def test_floods_and_routed_frames_are_read_as_they_were_written() -> None:
    tail = wire.tail_of(7, 8, INNER)
    relays = (Hop(A, 5, ()), Hop(C, 6, ()))
    flood = wire.encode(
        wire.FLOOD, tail, is_ack_wanted=False, attempt=0, hop_limit=3, urgency=2, listing=wire.relay_list(relays)
    )
    routed = wire.encode(
        wire.ROUTED,
        tail,
        is_ack_wanted=True,
        attempt=0,
        hop_limit=3,
        urgency=2,
        sequence=4,
        listing=wire.route_list([C, B]),
    )
    assert wire.decode(flood) == wire.Data(wire.FLOOD, False, 0, 3, 2, 0, relays, (), tail)
    assert wire.decode(routed) == wire.Data(wire.ROUTED, True, 0, 3, 2, 4, (), (C, B), tail)


@given(st.integers(0, 43), st.integers(1, 255))
def test_damage_to_what_routing_believes_is_noticed(at: int, change: int) -> None:
    """Kind, list, sequences and addresses; beyond them the protocols inside have their own checks."""
    tail = wire.tail_of(7, 8, INNER + bytes(40))
    listing = wire.relay_list((Hop(A, 5, ()),))
    body = bytearray(
        wire.encode(wire.FLOOD, tail, is_ack_wanted=False, attempt=0, hop_limit=3, urgency=2, listing=listing)
    )
    at = min(at, wire.HEAD_BYTES + len(listing) + wire.KEY_BYTES - 1)
    body[at] ^= change
    assert isinstance(wire.decode(bytes(body)), Drop)


@given(st.builds(Hello, macs, st.integers(0, 2**32 - 1), st.integers(0, 15), st.integers(0, 65535),
                 st.integers(0, 65535).map(lambda n: n / 1000), st.integers(0, 2**32 - 1),
                 st.integers(0, 255).map(lambda n: n / 255), st.booleans(), infos,
                 st.lists(heards, max_size=5).map(tuple)), st.integers(0, 40))  # fmt: skip
def test_a_hello_is_read_as_it_was_written(hello: Hello, padding: int) -> None:
    assert wire_control.decode_hello(wire_control.encode_hello(hello) + bytes(padding)) == hello


@given(
    st.builds(
        Topology,
        macs,
        st.integers(1, 255).map(float),
        infos,
        st.lists(st.builds(Incoming, macs, st.integers(0, 15), attributes), max_size=9).map(tuple),
    )
)
def test_a_tc_is_read_as_it_was_written(topology: Topology) -> None:
    assert wire_control.decode_tc(wire_control.encode_tc(topology)) == topology


def test_an_acknowledgement_is_read_as_it_was_written_and_damage_is_noticed() -> None:
    body = wire_control.encode_ack(Ack(65535, 2, 0x80000001))
    assert wire_control.decode_ack(body + bytes(36)) == Ack(65535, 2, 0x80000001)
    for at in range(1, len(body)):
        damaged = bytes((*body[:at], body[at] ^ 4, *body[at + 1 :]))
        assert wire_control.decode_ack(damaged) is Drop.CHECK


@given(st.lists(st.binary(min_size=1, max_size=40).map(lambda b: bytes((wire.ACK,)) + b), min_size=1, max_size=6))
def test_an_aggregate_is_split_into_what_it_was_made_of(bodies: list[bytes]) -> None:
    assert wire.split(wire.aggregate(bodies) + bytes(30)) == bodies


def test_no_aggregate_within_an_aggregate() -> None:
    assert wire.split(wire.aggregate([wire.aggregate([b"x"])])) is Drop.MALFORMED


@given(st.sampled_from(sorted(wire.KINDS)) | st.integers(0, 255), st.binary(max_size=120))
def test_decoders_never_raise(kind: int, rest: bytes) -> None:
    body = bytes((kind,)) + rest
    for decode in (wire.decode, wire.split, wire_control.decode_hello, wire_control.decode_tc, wire_control.decode_ack):
        decode(body)
        decode(rest)


def test_what_is_told_survives_the_wire_unchanged() -> None:
    told = wire_control.quantised(Attributes(0.1234, 17.6, 5_500_000))
    assert wire_control.quantised(told) == told
    assert told.loss_ratio == pytest.approx(0.1234, abs=1 / 255)
    assert told.snr_db == 18.0
    assert told.rate_bps == pytest.approx(5_500_000, rel=0.05)
