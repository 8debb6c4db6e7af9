from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core.rangeset import RangeSet


@given(st.lists(st.integers(0, 60), max_size=80))
def test_it_holds_what_was_added_as_disjoint_ranges(numbers: list[int]) -> None:
    ranges, model = RangeSet(max_ranges=100), set[int]()
    for number in numbers:
        assert ranges.add(number) is (number not in model)
        model.add(number)
    assert {n for n in range(70) if n in ranges} == model
    pairs = ranges.newest(100)
    assert {n for first, last in pairs for n in range(first, last + 1)} == model
    assert all(high[0] - low[1] >= 2 for high, low in pairwise(pairs))
    assert ranges.highest == max(model, default=-1)


@given(st.lists(st.integers(0, 200), max_size=80), st.integers(1, 5))
def test_it_is_bounded_and_never_forgets_what_it_holds(numbers: list[int], limit: int) -> None:
    ranges = RangeSet(max_ranges=limit)
    for number in numbers:
        ranges.add(number)
        assert len(ranges) <= limit
    assert all(number in ranges for number in numbers)


@given(st.lists(st.integers(0, 60)), st.integers(0, 70))
def test_everything_below_the_floor_counts_as_held(numbers: list[int], floor: int) -> None:
    ranges = RangeSet(max_ranges=100)
    for number in numbers:
        ranges.add(number)
    ranges.raise_floor(floor)
    assert {n for n in range(80) if n in ranges} == set(range(floor)) | set(numbers)
    assert all(first >= floor for first, _last in ranges.newest(100))


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 9)), max_size=30), st.integers(0, 40))
def test_ranges_are_added_as_their_numbers_would_be(ranges: list[tuple[int, int]], floor: int) -> None:
    whole, singly = RangeSet(max_ranges=4), RangeSet(max_ranges=4)
    for first, more in ranges:
        whole.raise_floor(floor)
        singly.raise_floor(floor)
        whole.add_range(first, first + more)
        for number in range(first, first + more + 1):
            singly.add(number)
        assert whole.newest(10) == singly.newest(10)
        assert (whole.floor, whole.highest) == (singly.floor, singly.highest)
