"""What was seen is not new again; memory stays bounded."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from netlab.flood.duplicates import WINDOW, Duplicates

A, B = b"\x02aaaaa", b"\x02bbbbb"


@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(0, WINDOW - 1), min_size=1, max_size=60),
)
def test_within_the_window_each_is_new_exactly_once_in_any_order(first: int, order: list[int]) -> None:
    seen = Duplicates()
    told = [(number, seen.is_new(A, 7, (first + number) % 2**32, now=0.0)) for number in order]
    assert [is_new for _, is_new in told] == [number not in order[:place] for place, number in enumerate(order)]


@given(st.lists(st.integers(0, 3 * WINDOW), max_size=80))
def test_nothing_is_new_twice_however_far_it_comes_behind(order: list[int]) -> None:
    seen = Duplicates()
    new = [number for number in order if seen.is_new(A, 7, number, now=0.0)]
    assert len(new) == len(set(new))


def test_what_is_older_than_the_window_counts_as_seen() -> None:
    seen = Duplicates()
    assert seen.is_new(A, 7, WINDOW, now=0.0)
    assert not seen.is_new(A, 7, 0, now=0.0)
    assert seen.is_new(A, 7, 1, now=0.0)


def test_originators_and_their_starts_are_told_apart() -> None:
    seen = Duplicates()
    assert [seen.is_new(*key, 5, now=0.0) for key in ((A, 1), (B, 1), (A, 2), (A, 1), (B, 1))] == [True] * 3 + [
        False
    ] * 2
    assert seen.is_new(A, 3, 1, now=0.0), "a new start begins anew"


def test_the_silent_are_forgotten_and_the_oldest_go_first() -> None:
    seen = Duplicates(originators_max=2, forget_s=10.0)
    assert seen.is_new(A, 1, 1, now=0.0)
    assert seen.is_new(B, 1, 1, now=1.0)
    assert not seen.is_new(A, 1, 1, now=2.0)
    assert seen.is_new(b"\x02ccccc", 1, 1, now=3.0)
    assert len(seen) == 2
    assert not seen.is_new(A, 1, 1, now=4.0), "b was the one that had been silent longest"
    assert seen.is_new(A, 1, 1, now=14.5)
    assert len(seen) == 1


@given(st.lists(st.tuples(st.binary(min_size=6, max_size=6), st.integers(0, 9)), max_size=200))
def test_memory_is_bounded(frames: list[tuple[bytes, int]]) -> None:
    seen = Duplicates(originators_max=5)
    for originator, sequence in frames:
        seen.is_new(originator, 0, sequence, now=0.0)
        assert len(seen) <= 5
