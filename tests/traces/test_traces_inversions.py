"""One test per clause of the definition at the top of netlab/traces/inversions.py."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.traces.inversions import inversions
from netlab.traces.model import EVERYBODY

SERIALISATION_S = 1442 * 8 / 10e6  # 1.1536 ms


@pytest.fixture
def waiting(story: Any) -> Any:
    """Telemetry #0 is published at 1.0 s and leaves at 1.1 s: a bulk fragment between them is an inversion."""
    story.publish(0, 0, 1.0)
    story.publish(1, 0, 0.5)
    story.send(0, 0, 1.1)
    return story


def count(story: Any, node: str = "a") -> int:
    return len(inversions(story.trace, node))


def test_a_bulk_fragment_between_publication_and_departure_is_one(waiting: Any) -> None:
    waiting.send(1, 0, 1.05)
    (found,) = inversions(waiting.trace, "a")
    assert (found.fragment.priority, found.stream.topic, found.seq) == (9, "telemetry", 0)
    assert found.waited_s == pytest.approx(0.05)


def test_before_the_publication_and_after_the_departure_there_is_none(waiting: Any) -> None:
    waiting.send(1, 0, 0.99)
    waiting.send(1, 1, 1.1001)
    assert count(waiting) == 0


@pytest.mark.parametrize(("after_s", "expected"), [(0.0009, 0), (0.001, 0), (0.0011, 1)])
def test_the_first_millisecond_is_forgiven(waiting: Any, after_s: float, expected: int) -> None:
    waiting.send(1, 0, 1.0 + after_s)
    assert count(waiting) == expected


@pytest.mark.parametrize(("after_s", "expected"), [(0.0011, 0), (0.001 + SERIALISATION_S, 0), (0.0022, 1)])
def test_so_is_the_serialisation_of_one_fragment(waiting: Any, after_s: float, expected: int) -> None:
    waiting.trace.rates_bps["a", "eth0"] = [(0, 10e6)]
    waiting.send(1, 0, 1.0 + after_s)
    assert count(waiting) == expected


def test_the_rate_of_another_interface_forgives_nothing(waiting: Any) -> None:
    waiting.trace.rates_bps["a", "eth1"] = [(0, 10e6)]
    waiting.send(1, 0, 1.0015)
    assert count(waiting) == 1


def test_the_rate_at_that_time_counts(waiting: Any) -> None:
    changed_ns = waiting.trace.t0_ns + 1_001_800_000
    waiting.trace.rates_bps["a", "eth0"] = [(0, 10e6), (changed_ns, None)]
    waiting.send(1, 0, 1.0017)
    waiting.send(1, 1, 1.0019)
    assert [found.fragment.message_id for found in inversions(waiting.trace, "a")] == [1001]


def test_equally_or_more_urgent_fragments_may_go_first(story: Any) -> None:
    story.publish(1, 0, 1.0)
    story.send(1, 0, 1.1)
    story.send(0, 0, 1.05)
    story.send(1, 7, 1.06)
    assert count(story) == 0


def test_a_message_waits_until_its_last_fragment_has_left(waiting: Any) -> None:
    waiting.publish(0, 1, 2.0)
    for index, at_s in enumerate((2.0, 2.01, 2.05)):
        waiting.send(0, 1, at_s, index=index, count=3)
    waiting.send(1, 0, 2.02)  # between its second and its third fragment
    waiting.send(1, 1, 2.06)
    assert count(waiting) == 1


def test_a_retransmission_of_the_urgent_message_is_no_unsent_fragment(waiting: Any) -> None:
    waiting.send(0, 0, 1.3)
    waiting.send(1, 0, 1.2)
    assert count(waiting) == 0


def test_a_retransmitted_bulk_fragment_waits_its_turn_too(waiting: Any) -> None:
    waiting.send(1, 0, 0.6)
    waiting.send(1, 0, 1.05)
    assert count(waiting) == 1


def test_a_fragment_counts_once_however_many_messages_wait(waiting: Any) -> None:
    for seq in range(1, 5):
        waiting.publish(0, seq, 1.0 + seq / 1000)
        waiting.send(0, seq, 1.1 + seq / 1000)
    waiting.send(1, 0, 1.05)
    assert count(waiting) == 1


def test_a_refused_message_does_not_wait(story: Any) -> None:
    story.publish(0, 0, 1.0, accepted=False)
    story.send(1, 0, 1.05)
    assert count(story) == 0


def test_an_offline_destination_excuses(waiting: Any) -> None:
    waiting.peer("a", "b", 0.0, online=True)
    waiting.peer("a", "b", 1.04, online=False)
    waiting.peer("a", "b", 1.06, online=True)
    waiting.send(1, 0, 1.03)
    waiting.send(1, 1, 1.05, destination="c")
    waiting.send(1, 2, 1.07)
    assert [found.fragment.message_id for found in inversions(waiting.trace, "a")] == [1000, 1002]


def test_a_peer_that_was_never_met_is_not_online(waiting: Any) -> None:
    waiting.peer("a", "c", 0.0, online=True)
    waiting.send(1, 0, 1.05, destination="c")
    assert count(waiting) == 0


def test_another_nodes_reports_excuse_nothing_here(waiting: Any) -> None:
    waiting.peer("b", "a", 0.0, online=True)
    waiting.send(1, 0, 1.05)
    assert count(waiting) == 1


@pytest.mark.parametrize(("in_flight", "expected"), [(4000, 1), (4559, 0), (6000, 0)])
def test_a_full_window_excuses_fragments_to_others(waiting: Any, in_flight: float, expected: int) -> None:
    waiting.window("a", "b", 0.9, cwnd=6000, in_flight=in_flight)
    waiting.send(1, 0, 1.05, destination="c")
    assert count(waiting) == expected


def test_the_latest_report_before_the_fragment_counts(waiting: Any) -> None:
    waiting.window("a", "b", 0.9, cwnd=6000, in_flight=6000)
    waiting.window("a", "b", 1.0, cwnd=6000, in_flight=0)
    waiting.window("a", "b", 1.06, cwnd=6000, in_flight=6000)
    waiting.send(1, 0, 1.05, destination="c")
    assert count(waiting) == 1


def test_a_fragment_to_the_same_destination_proves_room_in_its_window(waiting: Any) -> None:
    waiting.window("a", "b", 0.9, cwnd=6000, in_flight=6000)
    waiting.send(1, 0, 1.05)
    assert count(waiting) == 1


def test_all_interfaces_of_a_node_share_one_order(waiting: Any) -> None:
    waiting.send(1, 0, 1.05, interface="eth1")
    assert count(waiting) == 1


def test_a_broadcast_of_the_message_is_its_departure(story: Any) -> None:
    story.publish(0, 0, 1.0)
    story.send(0, 0, 1.001, destination=EVERYBODY)
    story.send(1, 0, 1.05)
    assert count(story) == 0


def test_the_same_message_to_somebody_else_is_not_its_departure(story: Any) -> None:
    story.publish(0, 0, 1.0)
    story.send(0, 0, 1.001, destination="c")
    story.send(0, 0, 1.1, destination="b")
    story.send(1, 0, 1.05)
    assert count(story) == 1


def test_a_message_that_never_left_waits_until_the_next_of_its_stream(story: Any) -> None:
    story.publish(0, 0, 1.0)
    story.publish(0, 1, 1.2)
    story.send(0, 1, 1.2)
    story.send(1, 0, 1.1)
    story.send(1, 1, 1.3)
    assert [found.fragment.message_id for found in inversions(story.trace, "a")] == [1000]


def test_a_message_that_was_given_up_waits_no_longer(story: Any) -> None:
    story.publish(0, 0, 1.0)
    story.send(0, 0, 1.001, index=0, count=2)
    story.trace.dropped_ns["a", 0] = [story.trace.t0_ns + 1_100_000_000]
    story.send(1, 0, 1.05)
    story.send(1, 1, 1.15)
    assert [found.fragment.message_id for found in inversions(story.trace, "a")] == [1000]


def test_other_nodes_are_not_judged(waiting: Any) -> None:
    waiting.send(1, 0, 1.05)
    assert count(waiting, "b") == 0
    assert count(waiting, "nobody") == 0


@given(
    publish=st.lists(st.integers(0, 300), max_size=12),
    hold=st.lists(st.integers(0, 60), min_size=12, max_size=12),
    bulk=st.lists(st.integers(0, 400), max_size=30),
)
def test_the_fast_answer_is_the_slow_one(
    story_class: Any, publish: list[int], hold: list[int], bulk: list[int]
) -> None:
    """Against the definition, spelt out message by message."""
    story = story_class()
    for seq, at_ms in enumerate(sorted(publish)):
        story.publish(0, seq, at_ms / 1000)
        story.send(0, seq, (at_ms + hold[seq]) / 1000)
    for seq, at_ms in enumerate(sorted(bulk)):
        story.send(1, seq, at_ms / 1000 + 0.0005)
    departures = [at_ms + hold[seq] for seq, at_ms in enumerate(sorted(publish))]
    expected = sum(
        any(start + 1 < at_ms + 0.5 < end for start, end in zip(sorted(publish), departures, strict=True))
        for at_ms in bulk
    )
    assert len(inversions(story.trace, "a")) == expected
