"""Frames in a stream of bytes: they come out as they went in, and nothing else does."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core import cobs

# Zeros and long runs without one are what the encoding is about.
DATA = st.one_of(
    st.binary(max_size=600), st.lists(st.sampled_from([b"\0", b"a", b"b" * 253]), max_size=6).map(b"".join)
)


def test_frames_are_the_documented_bytes() -> None:
    assert cobs.encode(b"") == bytes.fromhex("01 01 01 01 01 00")
    assert cobs.encode(b"\0") == bytes.fromhex("01 05 d202ef8d 00")
    assert cobs.encode(b"11\x0022") == bytes.fromhex("03 3131 07 3232 3753fc1e 00")


@given(DATA)
def test_what_is_encoded_is_decoded(data: bytes) -> None:
    frame = cobs.encode(data)
    assert frame.count(cobs.DELIMITER) == 1
    assert frame.endswith(cobs.DELIMITER)
    assert len(frame) <= len(data) + cobs.overhead_bytes(len(data))
    assert cobs.decode(frame[:-1]) == data


@pytest.mark.parametrize("size", [0, 1, 249, 250, 251, 503, 504, 505])
def test_the_overhead_is_reached_without_zeros(size: int) -> None:
    data = b"\1" * size
    checksum_has_no_zero = 0 not in cobs.zlib.crc32(data).to_bytes(4, "big")
    if checksum_has_no_zero:
        assert len(cobs.encode(data)) == size + cobs.overhead_bytes(size)


@given(st.binary(max_size=300))
def test_any_bytes_are_decoded_without_an_exception(data: bytes) -> None:
    cobs.decode(data)
    deframer = cobs.Deframer(longest_bytes=100)
    deframer.feed(data)


@given(st.binary(min_size=1, max_size=200), st.data())
def test_a_damaged_frame_is_not_taken(data: bytes, draw: st.DataObject) -> None:
    frame = bytearray(cobs.encode(data)[:-1])
    at = draw.draw(st.integers(0, len(frame) - 1))
    frame[at] ^= draw.draw(st.integers(1, 255))
    assert cobs.decode(bytes(frame)) in (None, data)


@given(st.lists(st.binary(max_size=80), max_size=8), st.binary(max_size=20), st.data())
def test_a_stream_in_any_pieces_yields_the_frames_after_the_noise(
    messages: list[bytes], noise: bytes, draw: st.DataObject
) -> None:
    stream = noise + cobs.DELIMITER + b"".join(map(cobs.encode, messages))
    deframer, found, at = cobs.Deframer(longest_bytes=100), [], 0
    while at < len(stream):
        size = draw.draw(st.integers(1, 40))
        found += deframer.feed(stream[at : at + size])
        at += size
    assert found[len(found) - len(messages) :] == messages
    assert deframer.damaged <= noise.count(cobs.DELIMITER) + 1


def test_endless_noise_takes_no_memory_and_ends_at_the_next_delimiter() -> None:
    deframer = cobs.Deframer(longest_bytes=100)
    for _ in range(1000):
        assert deframer.feed(b"x" * 1000) == []
    assert deframer.feed(cobs.DELIMITER + cobs.encode(b"at last")) == [b"at last"]
    assert deframer.damaged == 1
