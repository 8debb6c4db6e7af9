"""What the plots show, from traces told in a few words."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.report.data import (
    Contact,
    Points,
    arrivals,
    envelope,
    grid,
    heartbeat_topic,
    latencies,
    points,
    volumes,
    waiting,
)
from netlab.traces.model import Delivery, Published, Stream, Trace

T0_NS = 1_800_000_000_000_000_000
STREAMS = (
    Stream(0, "robot1", "base", "pulse", 1),
    Stream(1, "robot1", "base", "video", 9),
    Stream(2, "base", "robot2", "command", 0),
    Stream(3, "robot2", "base", "pulse", 1),
)


def ns(at_s: float) -> int:
    return T0_NS + round(at_s * 1e9)


def trace(*messages: tuple[int, int, float, float | None], size_bytes: int = 100) -> Trace:
    """``messages``: stream, number, published at, received at (None: never)."""
    told = Trace("run.mcap", T0_NS, 100.0, STREAMS)
    for stream, seq, published_s, received_s in messages:
        told.published.setdefault(stream, []).append(Published(stream, stream, seq, ns(published_s), size_bytes))
        if received_s is not None:
            delivery = Delivery(stream, seq, ns(published_s), ns(received_s), size_bytes)
            told.delivered.setdefault(stream, []).append(delivery)
    return told


def test_times_between_messages_are_fitted_where_nothing_is_missing() -> None:
    rng = random.Random(1)
    late = [rng.gauss(0.2, 0.01) for _ in range(400)]
    told = trace(*((0, n, float(n), n + late[n]) for n in range(400) if n != 50))
    [found] = arrivals(told, "pulse")
    assert (found.interval_s, len(found.intervals_s), found.gaps) == (1.0, 397, 1)
    assert found.mean_s == pytest.approx(1.0, abs=0.002)
    assert found.sigma_s == pytest.approx(0.01 * 2**0.5, rel=0.15)
    assert found.ratio_within == 1.0


def test_a_message_that_waited_out_an_interruption_is_a_gap_and_no_arrival_time() -> None:
    received = [n + 0.1 if n < 15 else max(n + 0.1, 24.0) for n in range(40)]
    [found] = arrivals(trace(*((0, n, float(n), received[n]) for n in range(40))), "pulse")
    assert found.gaps == 1
    assert max(found.intervals_s) < 2.0
    assert found.ratio_within < 1.0, "what had waited came at once"


def test_a_missing_message_is_a_gap_however_soon_the_next_one_came() -> None:
    received = [float(n) for n in range(20)]
    received[6] = 5.9  # 1.9 s after number 4
    [found] = arrivals(trace(*((0, n, float(n), received[n] if n != 5 else None) for n in range(20))), "pulse")
    assert (found.gaps, len(found.intervals_s)) == (1, 17)


def test_few_messages_make_no_histogram() -> None:
    assert arrivals(trace(*((0, n, float(n), float(n)) for n in range(10))), "pulse") == []
    assert len(arrivals(trace(*((0, n, float(n), float(n)) for n in range(11))), "pulse")) == 1
    assert arrivals(trace(*((0, n, float(n), float(n)) for n in range(11))), "video") == []


def test_the_heartbeat_is_what_comes_nearest_to_one_hertz_or_is_called_so() -> None:
    told = trace(*((s, n, n * step, None) for s, step in ((0, 0.9), (1, 0.1), (2, 30.0)) for n in range(3)))
    assert heartbeat_topic(told) == "pulse"
    told.streams = (*STREAMS[:2], Stream(2, "base", "robot2", "management", 0))
    assert heartbeat_topic(told) == "management"
    assert heartbeat_topic(trace((0, 0, 0.0, None))) is None


def test_volumes_count_each_message_once() -> None:
    told = trace((0, 0, 0.0, 0.1), (0, 0, 0.0, 0.2), (0, 1, 1.0, None), (1, 0, 0.0, 0.1), (3, 0, 0.0, 0.1))
    assert volumes(told) == {"pulse": {"robot1": 100, "robot2": 100}, "video": {"robot1": 100}}


def test_latencies_stand_at_the_time_of_publication_most_urgent_first() -> None:
    found = latencies(trace((1, 0, 3.0, 4.5), (0, 1, 2.0, 2.25), (3, 0, 1.0, 1.5), (2, 0, 1.0, None)))
    assert found == {1: Points((1.0, 2.0), (0.5, 0.25)), 9: Points((3.0,), (1.5,))}
    assert list(found) == [1, 9]


def test_what_waits_rises_at_publication_and_falls_at_receipt() -> None:
    found = waiting(trace((0, 0, 1.0, 4.0), (1, 0, 2.0, 3.0), (1, 1, 2.5, None)))
    assert found == {"robot1": Points((1.0, 2.0, 3.0, 4.0), (100.0, 200.0, 100.0, 0.0))}


@given(st.lists(st.tuples(st.floats(0, 100), st.floats(-5, 5)), min_size=1, max_size=200), st.integers(1, 20))
def test_thinning_out_keeps_extremes_and_order(pairs: list[tuple[float, float]], columns: int) -> None:
    series = points(pairs)
    thin = envelope(series, columns=columns)
    assert len(thin.at_s) <= max(2 * columns, 1)
    assert (min(thin.values), max(thin.values)) == (min(series.values), max(series.values))
    assert list(thin.at_s) == sorted(thin.at_s)
    assert set(zip(thin.at_s, thin.values, strict=True)) <= set(zip(series.at_s, series.values, strict=True))


def test_contact_lasts_while_fresh_messages_come_through_either_way() -> None:
    sent = [(0, n, float(n), n + 0.1) for n in range(10)]
    stored = [(0, n, float(n), 30.1) for n in range(10, 30)]
    back = [(2, n, float(n), n + 0.1) for n in range(40, 50)]
    told = trace(*sent, *stored, *back)
    one, two = Contact(told, "robot1", "base"), Contact(told, "robot2", "base")
    states = [one.at(at_s) for at_s in (0.0, 9.5, 10.9, 11.1, 20.0, 29.9)]
    assert states == [True, True, True, False, False, True], "29 was published at most 2 s before it arrived"
    assert (two.at(39.0), two.at(45.0), two.is_known) == (False, True, True)
    assert not Contact(told, "relay", "base").is_known


def test_a_grid_averages_and_leaves_blank_what_nobody_knows() -> None:
    found = grid({"a": [(0.1, 1.0), (0.2, 0.0), (9.9, 4.0), (10.0, 9.0)], "b": []}, start_s=0.0, end_s=10.0, columns=2)
    assert found.rows == ("a", "b")
    assert found.column_s == 5.0
    assert found.values == ((0.5, 4.0), (None, None))
