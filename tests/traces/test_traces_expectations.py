from __future__ import annotations

from typing import Any

import pytest
from pydantic import TypeAdapter

from netlab.scenario.expect import AnyExpectation
from netlab.traces.expectations import ExpectationResult, evaluate

ADAPTER: TypeAdapter[Any] = TypeAdapter(AnyExpectation)


def ask(story: Any, **expectation: Any) -> list[ExpectationResult]:
    return evaluate([ADAPTER.validate_python(expectation)], story.trace)


def one(story: Any, **expectation: Any) -> ExpectationResult:
    (result,) = ask(story, **expectation)
    return result


@pytest.fixture
def quiet(story: Any) -> Any:
    """Ten telemetry messages, 10..100 ms late."""
    for seq in range(10):
        story.publish(0, seq, seq)
        story.deliver(0, seq, seq + (seq + 1) / 100, published_s=seq)
    return story


def test_each_bound_of_a_latency_is_a_result_of_its_own(quiet: Any) -> None:
    p50, p99 = ask(quiet, latency={"topic": "telemetry", "from": "a", "to": "b"}, p50="50ms", p99="60ms")
    assert (p50.passed, p50.measured, p50.limit, p50.explanation) == (True, pytest.approx(0.05), 0.05, "")
    assert (p99.passed, p99.measured, p99.limit) == (False, pytest.approx(0.1), 0.06)
    assert p99.name == "latency of telemetry a->b p99 <= 60.0 ms"
    assert "telemetry a->b: slowest is #9, 100.0 ms after its publication" in p99.explanation


def test_a_stream_without_any_delivery_fails_its_latency(story: Any) -> None:
    story.publish(0, 0, 1.0)
    result = one(story, latency={"topic": "telemetry"}, p50="10s")
    assert (result.passed, result.measured) == (False, None)
    assert "nothing was delivered" in result.explanation


def test_an_unknown_stream_fails(story: Any) -> None:
    result = one(story, delivered={"topic": "telemetry", "to": "z"}, min="1%")
    assert not result.passed
    assert "no such stream" in result.explanation


def test_every_stream_of_a_topic_must_meet_the_bound(story: Any) -> None:
    from netlab.traces.model import Stream

    story.trace.streams += (Stream(4, "b", "c", "telemetry", 1),)
    story.publish(0, 0, 1.0)
    story.deliver(0, 0, 1.01, published_s=1.0)
    assert one(story, latency={"topic": "telemetry", "from": "a"}, max="20ms").passed
    both = one(story, latency={"topic": "telemetry"}, max="20ms")
    assert not both.passed
    assert "telemetry b->c" in both.explanation


def test_delivered_counts_refused_messages_against_it(quiet: Any) -> None:
    assert one(quiet, delivered={"topic": "telemetry"}, min="100%").passed
    quiet.publish(0, 10, 9.5, accepted=False)
    result = one(quiet, delivered={"topic": "telemetry"}, min="100%")
    assert (result.passed, result.measured) == (False, pytest.approx(10 / 11))
    assert "10 of 11 delivered, 1 refused; the first that is missing is #10" in result.explanation
    assert "publish telemetry #10 refused (peer_offline)" in result.explanation


def test_nothing_published_is_not_everything_delivered(story: Any) -> None:
    assert not one(story, delivered={"topic": "telemetry"}, min="0%").passed


def test_reconnect_judges_the_worst_restoration(story: Any) -> None:
    story.restore(("a", "b"), 2.0)
    story.restore(("b", "a"), 6.0)
    story.deliver(0, 0, 2.05, published_s=2.01)
    story.deliver(0, 1, 6.3, published_s=6.1)
    assert one(story, reconnect={"between": ["b", "a"]}, max="300ms").passed
    result = one(story, reconnect={"between": ["a", "b"]}, max="200ms")
    assert (result.passed, result.measured) == (False, pytest.approx(0.3))
    assert "6.000 s" in result.explanation


def test_no_fresh_message_or_no_restoration_fails_a_reconnect(story: Any) -> None:
    nothing = one(story, reconnect={"between": ["a", "b"]}, max="10s")
    assert (nothing.passed, nothing.measured) == (False, None)
    assert "nothing was restored" in nothing.explanation
    story.restore(("a", "b"), 2.0)
    silent = one(story, reconnect={"between": ["a", "b"]}, max="10s")
    assert (silent.passed, silent.measured) == (False, None)
    assert "no message published since then came through" in silent.explanation


def test_inversions_and_retransmissions_are_counted_at_their_node(story: Any) -> None:
    story.publish(0, 0, 1.0)
    story.send(0, 0, 1.1)
    story.send(1, 0, 1.05)
    story.send(1, 0, 1.06)
    assert one(story, priority_inversions={"at": "a"}, max=2).passed
    inverted = one(story, priority_inversions={"at": "a"}, max=1)
    assert (inverted.passed, inverted.measured, inverted.limit) == (False, 2, 1)
    assert "priority 9 left while telemetry a->b #0 of priority 1 had waited 60.0 ms" in inverted.explanation
    again = one(story, retransmissions={"at": "a"}, max=0)
    assert (again.passed, again.measured) == (False, 1)
    assert one(story, retransmissions={"at": "b"}, max=0).passed


def test_goodput_gap_and_duplicates(quiet: Any) -> None:
    quiet.deliver(0, 3, 3.5, published_s=3.0)
    goodput = one(quiet, goodput={"topic": "telemetry"}, min="1kbit")
    assert (goodput.passed, goodput.measured) == (False, pytest.approx(800))
    assert one(quiet, goodput={"topic": "telemetry"}, min="800bit").passed
    gap = one(quiet, longest_gap={"topic": "telemetry"}, max="1s")
    assert (gap.passed, gap.measured) == (False, pytest.approx(1.01))
    assert one(quiet, longest_gap={"topic": "telemetry"}, max="1.02s").passed
    duplicates = one(quiet, duplicates={"topic": "telemetry"}, max=0)
    assert (duplicates.passed, duplicates.measured) == (False, 1)
    assert "the first is #3" in duplicates.explanation
    assert one(quiet, duplicates={"topic": "telemetry"}, max=1).passed


def test_a_failure_shows_what_happened_around_it_and_where_the_capture_is(story: Any) -> None:
    story.restore(("a", "b"), 5.0)
    story.peer("a", "b", 4.5, online=False)
    story.peer("a", "b", 6.9, online=True)
    story.peer("b", "a", 9.0, online=True)
    story.deliver(0, 0, 6.95, published_s=6.9)
    lines = one(story, reconnect={"between": ["a", "b"]}, max="200ms").explanation.splitlines()
    assert [line.strip() for line in lines] == [
        "4.500 s   a: b down",
        "5.000 s   timeline: restored ('a', 'b')",
        "5.000 s > restored; the first fresh message came 1950.0 ms later",
        "6.900 s   a: b up",
        "capture: run.mcap",
    ]
