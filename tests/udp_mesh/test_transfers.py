"""What has become of a message's fragments: sent, acknowledged, waiting to be sent again, singly and in runs."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core.messages import Message, Transfer
from udp_mesh.core.settings import TopicPolicy

FRAGMENTS = 12


def transfer() -> Transfer:
    message = Message(1, "t", bytes(100 * FRAGMENTS - 2), TopicPolicy(), datagram_bytes=137, now=0.0)
    assert message.fragment_count == FRAGMENTS
    return Transfer(message, "b", (0, 0.0, 0))


def test_fragments_acknowledged_twice_count_once() -> None:
    sent = transfer()
    sent.advance(0, FRAGMENTS)
    assert sent.acknowledge(0, 6)
    assert sent.acknowledge(3, 6)
    assert not sent.acknowledge(4, 2)
    assert (sent.acked_count, sent.is_complete) == (9, False)
    assert sent.acknowledge(9, 3)
    assert sent.is_complete


def test_lost_neighbours_leave_again_as_one_run() -> None:
    sent = transfer()
    sent.advance(0, FRAGMENTS)
    assert sent.send_again([2, 3, 4, 8])
    assert (sent.peek(), sent.run_length(44), sent.run_length(2)) == (2, 3, 2)
    sent.advance(20, 3)
    assert (sent.peek(), sent.run_length(44)) == (8, 1)
    assert sent.was_repeated_after(3, 3)
    assert not sent.was_repeated_after(3, 21)
    sent.acknowledge(8)
    assert (sent.peek(), sent.run_length(44)) == (None, 0)


def test_the_last_fragment_is_never_part_of_a_run() -> None:
    sent = transfer()
    assert sent.run_length(44) == FRAGMENTS - 1
    sent.advance(0, FRAGMENTS - 1)
    assert (sent.peek(), sent.run_length(44)) == (FRAGMENTS - 1, 0)
    sent.advance(FRAGMENTS - 1)
    sent.send_again([FRAGMENTS - 2, FRAGMENTS - 1])
    assert sent.run_length(44) == 1


@given(
    st.lists(st.tuples(st.sampled_from(["lost", "acked", "send"]), st.integers(0, FRAGMENTS - 1), st.integers(1, 5)))
)
def test_every_fragment_is_sent_until_it_is_acknowledged(steps: list[tuple[str, int, int]]) -> None:
    subject, number = transfer(), 0
    in_flight, acked = set[int](), set[int]()
    for action, first, count in [*steps, *[("send", 0, 1)] * 40]:
        among = range(first, min(first + count, FRAGMENTS))
        if action == "send":
            index = subject.peek()
            if index is None:
                continue
            length = max(1, min(count, subject.run_length(count)))
            subject.advance(number, length)
            number += length
            in_flight |= set(range(index, index + length))
        elif action == "lost":
            lost = [index for index in among if index in in_flight]
            in_flight -= set(lost)
            subject.send_again(lost)
        elif set(among) <= in_flight | acked:
            in_flight -= set(among)
            acked |= set(among)
            subject.acknowledge(first, len(among))
        assert subject.acked_count == len(acked)
    assert in_flight | acked == set(range(FRAGMENTS))
