"""Dots, places and projections; the tour's steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.tui.braille import Layer, characters
from netlab.tui.projection import Bounds, distance_to_line, fit, in_a_circle, nearest
from netlab.tui.tour import STEPS, Deed, Tour

coordinates = st.floats(-1000, 1000)


def test_each_dot_has_its_bit() -> None:
    """The order of the Unicode Standard, chapter 21.1: the left column, then the right one, then the lowest row."""
    for place, (column, row) in enumerate([(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)]):
        layer = Layer(1, 1)
        layer.set(np.array([float(column)]), np.array([float(row)]), np.array([1], dtype=np.uint8))
        assert characters(layer.masks[0]) == chr(0x2800 + (1 << place))


def test_lines_cross_cells_and_the_higher_ink_wins() -> None:
    layer = Layer(4, 1)
    layer.draw([((0, 0), (7, 0), 2, 1), ((0, 3), (7, 3), 1, 1)])
    assert characters(layer.masks[0]) == "⣉" * 4
    assert layer.inks[0].tolist() == [2, 2, 2, 2]


def test_gaps_leave_dots_out() -> None:
    layer = Layer(8, 1)
    layer.draw([((0, 0), (15, 0), 1, 4)])
    assert characters(layer.masks[0]) == "⠁ ⠁ ⠁ ⠁ "


@given(st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=20), st.integers(20, 200), st.integers(8, 60))
def test_all_places_are_on_the_screen_and_come_back(points: list[tuple[float, float]], columns: int, rows: int) -> None:
    projection = fit(Bounds.of(points), columns, rows)
    for point in points:
        column, row = projection.cell(point)
        assert 0 <= column < columns
        assert 0 <= row < rows
        back = projection.place(column, row)
        assert back == pytest.approx(point, abs=4 / projection.dots_per_m)


@given(st.tuples(coordinates, coordinates), st.tuples(coordinates, coordinates))
def test_lines_outside_are_left_out(a: tuple[float, float], b: tuple[float, float]) -> None:
    layer = Layer(10, 5)
    layer.draw([(a, b, 1, 1)])
    assert layer.masks.shape == (5, 10)


def test_nodes_without_places_get_some_of_their_own() -> None:
    places = in_a_circle([f"n{number}" for number in range(12)])
    assert len(set(places.values())) == 12


def test_the_nearest_within_reach() -> None:
    cells = {"a": (0, 0), "b": (4, 0)}
    assert nearest((1, 0), cells, within=3) == "a"
    assert nearest((3, 0), cells, within=3) == "b"
    assert nearest((20, 0), cells, within=3) is None
    assert distance_to_line((5, 3), (0, 0), (10, 0)) == 3
    assert distance_to_line((-4, 3), (0, 0), (10, 0)) == 5
    assert distance_to_line((3, 4), (0, 0), (0, 0)) == 5


def test_the_tour_goes_on_by_the_deed_that_it_asks_for() -> None:
    tour = Tour()
    assert not tour.saw(Deed.CUT)
    assert tour.saw(Deed.NEXT)
    assert tour.saw(Deed.NODE)
    for step in STEPS[2:]:
        assert tour.step is step
        assert tour.saw(step.deed)
    assert tour.step is None
    assert not tour.saw(Deed.NEXT)
