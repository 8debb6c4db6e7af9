"""Jitter buffer, latest values, deadlines: what services do with data that comes as it likes."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rose.core.addressing import ServiceId
from rose.core.buffers import Deadline, Freshness, JitterBuffer, LatestValues
from rose.core.reception import Sample
from tests.rose.messages import Pose

LASER, MAP = ServiceId.parse("10.0.0.1/0.1"), ServiceId.parse("10.0.0.2/0.2")


def sample(sequence: int, variation_s: float, *, is_restart: bool = False) -> Sample:
    return Sample(
        message=Pose(float(sequence), 0.0),
        sender=LASER,
        sequence=sequence,
        lost_before=0,
        is_late=False,
        is_restart=is_restart,
        age_s=variation_s,
        delay_variation_s=variation_s,
        completeness=1.0,
        missing=(),
    )


@given(st.integers(0, 2**32))
def test_samples_come_out_evenly_and_in_order_however_they_arrive(seed: int) -> None:
    """Published every 100 ms, on the way for 0 to 80 ms more than the quickest, with a buffer of 100 ms."""
    rng = random.Random(seed)
    buffer = JitterBuffer(0.1)
    delays_s = [rng.uniform(0, 0.08) for _ in range(20)]
    arrivals = sorted((number * 0.1 + delay_s, number, delay_s) for number, delay_s in enumerate(delays_s))
    out: list[tuple[float, int]] = []
    for at_s, number, delay_s in [*arrivals, (100.0, -1, 0.0)]:
        while (due := buffer.next_due()) is not None and due <= at_s:
            out += [(due, taken.sequence) for taken in buffer.take(now=due)]
        if number >= 0:
            buffer.put(sample(number, delay_s), now=at_s)
    assert [number for _at_s, number in out] == list(range(20))
    assert [at_s for at_s, _number in out] == pytest.approx([number * 0.1 + 0.1 for number in range(20)])
    assert buffer.too_late == 0


def test_what_has_missed_its_turn_is_dropped_and_counted() -> None:
    buffer = JitterBuffer(0.05)
    buffer.put(sample(0, 0.0), now=1.0)
    buffer.put(sample(1, 0.06), now=1.16)
    assert buffer.too_late == 1
    assert [s.sequence for s in buffer.take(now=2.0)] == [0]
    buffer.put(sample(0, 0.0), now=2.0)
    assert buffer.too_late == 2


def test_a_restarted_sender_begins_anew() -> None:
    buffer = JitterBuffer(0.05)
    buffer.put(sample(100, 0.0), now=1.0)
    assert [s.sequence for s in buffer.take(now=2.0)] == [100]
    buffer.put(sample(0, 0.0, is_restart=True), now=3.0)
    buffer.put(sample(1, 0.0), now=3.1)
    assert [s.sequence for s in buffer.take(now=4.0)] == [0, 1]


def test_the_buffer_is_bounded() -> None:
    buffer = JitterBuffer(10.0, samples_max=5)
    for number in range(9):
        buffer.put(sample(number, 0.0), now=float(number))
    assert buffer.overflowed == 4
    assert [s.sequence for s in buffer.take(now=100.0)] == [4, 5, 6, 7, 8]


def test_latest_values_are_only_good_while_fresh() -> None:
    values: LatestValues[str] = LatestValues(fresh_s=1.0)
    values.put(LASER, "near", now=10.0)
    values.put(MAP, "small", now=10.5)
    assert values.get(LASER, now=11.0) == "near"
    assert values.get(LASER, now=11.01) is None
    assert values.fresh(now=11.2) == {MAP: "small"}
    values.put(LASER, "far", now=11.3)
    assert values.get(LASER, now=11.3) == "far"


def test_a_deadline_tells_silence_from_a_sender_that_never_was() -> None:
    deadline = Deadline(0.5)
    assert deadline.state(now=100.0) is Freshness.NEVER_SEEN
    deadline.seen(now=100.0)
    assert deadline.state(now=100.5) is Freshness.FRESH
    assert deadline.next_due() == 100.5
    assert deadline.state(now=100.51) is Freshness.STALE
