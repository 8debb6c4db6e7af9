"""Partial messages: in any order, singly or in runs, with duplicates and contradictions, within the memory allowed."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core import wire
from udp_mesh.core.messages import Message
from udp_mesh.core.reassembly import Reassembler, ReassemblyMemory, Verdict, WholeMessage
from udp_mesh.core.settings import TopicPolicy
from udp_mesh.core.wire_runs import Run

DATAGRAM_BYTES = 100


def message_of(size_bytes: int) -> Message:
    payload = bytes(k % 251 for k in range(size_bytes))
    return Message(3, "topic", payload, TopicPolicy(4), datagram_bytes=DATAGRAM_BYTES, now=0.0)


def fragment(message: Message, index: int) -> wire.DataFragment:
    header = wire.encode_header(epoch=1, destination_tag=1, packet_number=0, flags=0)
    packet = wire.dissect(header + b"".join(message.fragment(index)))
    assert packet is not None
    return packet.fragments[0]


def run(message: Message, first: int, count: int) -> Run:
    topic_bytes = len(message.topic_prefix) if first == 0 else 0
    return Run(
        epoch=1,
        destination_tag=1,
        packet_number=0,
        message_id=message.message_id,
        priority=4,
        flags=0,
        fragment_index=first,
        fragment_count=message.fragment_count,
        topic=message.topic if first == 0 else None,
        topic_bytes=topic_bytes,
        payloads=message.payloads(first, count),
        ack_now=False,
    )


@given(st.integers(100, 1000), st.data())
def test_whatever_the_order_the_message_is_whole_once_and_memory_returns(size_bytes: int, data: st.DataObject) -> None:
    message, memory = message_of(size_bytes), ReassemblyMemory(50_000)
    reassembler, have, whole = Reassembler(memory), set[int](), []
    last = message.fragment_count - 1
    while not whole:
        missing = sorted(set(range(last + 1)) - have)
        first = data.draw(st.sampled_from(missing) | st.integers(0, last))
        count, result = 1, None
        if first < last and data.draw(st.booleans()):
            count = data.draw(st.integers(1, last - first))
            result = reassembler.take_run(run(message, first, count), now=1.0)
            assert (result is None) == bool(have & set(range(first, first + count)))
        if result is None:
            count, result = 1, reassembler.take(fragment(message, first), now=1.0)
            assert (result is Verdict.DUPLICATE) == (first in have)
        have |= set(range(first, first + count))
        if isinstance(result, WholeMessage):
            whole.append(result)
        assert bool(whole) == (len(have) == last + 1)
        assert memory.reserved_bytes <= message.fragment_count * 1400
    (only,) = whole
    assert (only.topic, only.about.priority, only.payload) == ("topic", 4, bytes(message.payload))
    assert memory.reserved_bytes == 0
    assert reassembler.take(fragment(message, 0), now=1.0) is Verdict.DUPLICATE
    assert reassembler.take_run(run(message, 0, 1), now=1.0) is None


def test_fragments_of_another_length_contradict() -> None:
    message, reassembler = message_of(500), Reassembler(ReassemblyMemory(10_000))
    assert reassembler.take(fragment(message, 1), now=0.0) is Verdict.STORED
    short = fragment(message, 2)._replace(payload=fragment(message, 2).payload[1:])
    assert reassembler.take(short, now=0.0) is Verdict.CONTRADICTION
    long_end = fragment(message, message.fragment_count - 1)._replace(payload=memoryview(bytes(64)))
    assert reassembler.take(long_end, now=0.0) is Verdict.CONTRADICTION
    assert reassembler.take_run(run(message, 2, 2)._replace(fragment_count=99), now=0.0) is None
    assert reassembler.take_run(run(message, 2, 2), now=0.0) is Verdict.STORED


def test_a_run_without_room_changes_nothing() -> None:
    message, memory = message_of(5000), ReassemblyMemory(4000)
    reassembler = Reassembler(memory)
    assert reassembler.take_run(run(message, 0, 5), now=0.0) is None
    assert (len(reassembler), memory.reserved_bytes) == (0, 0)


def test_what_a_short_last_fragment_reserved_grows_with_the_true_length() -> None:
    payload = bytes(30_000)
    message = Message(3, "t", payload, TopicPolicy(4), datagram_bytes=9000, now=0.0)
    memory = ReassemblyMemory(100_000)
    reassembler = Reassembler(memory)
    reassembler.take(fragment(message, message.fragment_count - 1), now=0.0)
    reassembler.take(fragment(message, 1), now=0.0)
    assert memory.reserved_bytes >= 30_000
