"""Runs are only a faster way to write and read the same datagrams."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core import wire
from udp_mesh.core.wire_runs import decode_run, encode_run

EPOCH = 0x1122334455667788


def burst(
    *,
    number: int = 5,
    index: int = 0,
    count: int = 40,
    size: int = 4,
    length: int = 30,
    ack_now: bool = False,
    flags: int = 0,
) -> tuple[bytes, int]:
    """Return a run of ``size`` packets of message 9, and the length of each."""
    prefix = b"\x01t" if index == 0 else b""
    payloads = [memoryview(bytes([k]) * (length - (len(prefix) if k == 0 else 0))) for k in range(size)]
    data = encode_run(
        epoch=EPOCH,
        destination_tag=7,
        packet_number=number,
        message_id=9,
        priority=3,
        flags=flags,
        fragment_index=index,
        fragment_count=count,
        prefix=prefix,
        payloads=payloads,
        ack_now=ack_now,
    )
    return data, len(data) // size


runs = st.fixed_dictionaries(
    {
        "number": st.sampled_from([0, 5, 0xFFFFFFF0, 0x1FFFFFFFF, wire.MAX_NUMBER - 50]),
        "index": st.integers(0, 300),
        "count": st.integers(320, 65535),
        "size": st.integers(2, 20),
        "length": st.integers(3, 50),
        "ack_now": st.booleans(),
        "flags": st.sampled_from([0, wire.DATA_FLAG_ENVELOPE]),
    }
)


@given(runs)
def test_a_run_is_written_as_its_packets_would_be(values: dict[str, int]) -> None:
    data, size = burst(**values)  # type: ignore[arg-type]
    for k in range(values["size"]):
        packet = wire.dissect(data[k * size : (k + 1) * size])
        assert packet is not None
        is_last = k == values["size"] - 1
        assert (packet.epoch, packet.destination_tag, packet.packet_number) == (EPOCH, 7, values["number"] + k)
        assert packet.ack_now == (is_last and values["ack_now"])
        (fragment,) = packet.fragments
        topic = "t" if values["index"] + k == 0 else None
        assert fragment[:5] == (9, 3, topic, values["index"] + k, values["count"])
        assert fragment.flags == values["flags"]


@given(runs)
def test_a_run_comes_back_as_its_packets_would(values: dict[str, int]) -> None:
    data, size = burst(**values)  # type: ignore[arg-type]
    run = decode_run(memoryview(data), size)
    crosses = (values["number"] & 0xFFFFFFFF) + values["size"] > 0xFFFFFFFF
    if run is None or crosses:  # the low half of the packet number overflows: read in two parts, or one by one
        assert crosses
        return
    packets = [wire.dissect(data[at : at + size]) for at in range(0, len(data), size)]
    assert len(run.payloads) == len(packets)
    for k, packet in enumerate(packets):
        assert packet is not None
        fragment = packet.fragments[0]
        assert (run.epoch, run.destination_tag, run.packet_number + k) == (EPOCH, 7, packet.packet_number)
        assert (run.message_id, run.priority, run.fragment_index + k, run.fragment_count) == (
            *fragment[:2],
            *fragment[3:5],
        )
        assert (run.payloads[k], run.flags) == (fragment.payload, fragment.flags)
    first = packets[0]
    assert first is not None
    assert run.topic == first.fragments[0].topic
    assert run.ack_now == values["ack_now"]


@given(runs, st.data())
def test_a_damaged_run_is_read_no_further_than_it_is_sound(values: dict[str, int], data: st.DataObject) -> None:
    whole, size = burst(**values)  # type: ignore[arg-type]
    damaged = bytearray(whole)
    at = data.draw(st.integers(0, len(whole) - 1))
    damaged[at] ^= data.draw(st.integers(1, 255))
    run = decode_run(memoryview(damaged), size)
    for k in range(0 if run is None else len(run.payloads)):
        assert run is not None
        packet = wire.dissect(bytes(damaged[k * size : (k + 1) * size]))
        assert packet is not None
        assert packet.packet_number == run.packet_number + k
        assert packet.fragments[0].payload == run.payloads[k]
        assert packet.fragments[0].message_id == run.message_id
        assert len(packet.fragments) == 1


@given(st.binary(max_size=300), st.integers(0, 100))
def test_any_bytes_are_no_run_or_one_without_an_exception(data: bytes, size: int) -> None:
    decode_run(memoryview(data), size)
    decode_run(memoryview(burst()[0][:20] + data), size)


@pytest.mark.parametrize("change", ["the last fragment", "a shorter packet", "two frames", "another message"])
def test_what_is_no_run_is_left_to_the_usual_decoder(change: str) -> None:
    data, size = burst(index=3, count=5 if change == "the last fragment" else 40, size=2)
    if change == "a shorter packet":
        data = data[:-1]
    elif change == "two frames":
        data = data[:size] + wire.PING + data[size:] + wire.PING
        size += 1
    elif change == "another message":
        data = data[:size] + burst(index=4, number=6, size=2)[0][:size].replace(b"\0\x09\0", b"\0\x0a\0", 1)
    assert decode_run(memoryview(data), size) is None
