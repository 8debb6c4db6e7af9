"""Stretches laid over each other: nothing is counted twice, nothing is lost."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from netlab.traces.causes import Cause, Stretch, merged, painted


def stretches(cause: Cause) -> st.SearchStrategy[list[Stretch]]:
    ends = st.tuples(st.integers(0, 50), st.integers(0, 50)).map(sorted)
    return st.lists(ends.map(lambda pair: Stretch(pair[0], pair[1], cause)), max_size=5)


@given(cuts=st.lists(st.integers(0, 50), min_size=2, max_size=6).map(sorted), over=stretches(Cause.OUTAGE))
def test_the_whole_stays_covered_and_the_upper_one_counts(cuts: list[int], over: list[Stretch]) -> None:
    base = [Stretch(a, b, Cause.QUEUE) for a, b in pairwise(cuts)]
    out = painted(base, over)
    covered = [t for stretch in out for t in range(stretch.from_ns, stretch.to_ns)]
    assert covered == list(range(cuts[0], cuts[-1]))
    for stretch in out:
        for t in range(stretch.from_ns, stretch.to_ns):
            is_upper = any(top.from_ns <= t < top.to_ns for top in over)
            assert stretch.cause is (Cause.OUTAGE if is_upper else Cause.QUEUE)


@given(over=stretches(Cause.OUTAGE), under=stretches(Cause.RESTART))
def test_of_the_upper_ones_the_first_counts(over: list[Stretch], under: list[Stretch]) -> None:
    out = painted([Stretch(0, 50, Cause.QUEUE)], [*over, *under])
    for stretch in out:
        for t in range(stretch.from_ns, stretch.to_ns):
            if any(top.from_ns <= t < top.to_ns for top in over):
                assert stretch.cause is Cause.OUTAGE


def test_neighbours_of_one_cause_become_one() -> None:
    parts = [Stretch(0, 2, Cause.LOSS, "a"), Stretch(2, 2, Cause.QUEUE), Stretch(2, 5, Cause.LOSS, "a")]
    assert merged([*parts, Stretch(5, 6, Cause.LOSS, "b")]) == [
        Stretch(0, 5, Cause.LOSS, "a"),
        Stretch(5, 6, Cause.LOSS, "b"),
    ]
