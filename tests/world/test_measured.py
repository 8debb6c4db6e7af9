"""Measured values over time: held, interpolated, before the first and after the last of them."""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.world.measured import MeasuredStrengths, Series

INF = math.inf


@pytest.mark.parametrize(
    ("at_s", "held", "interpolated"),
    [(0.9, math.nan, math.nan), (1.0, 10, 10), (2.0, 10, 15), (3.0, 20, 20), (4.0, 20, 20), (5.0, INF, INF)],
)
def test_between_two_samples(at_s: float, held: float, interpolated: float) -> None:
    samples = [[(1.0, 10.0), (3.0, 20.0), (5.0, INF), (7.0, 5.0)], [(0.0, 1.0)]]
    assert Series(samples, interpolate=False).at(at_s) == pytest.approx([held, 1.0], nan_ok=True)
    assert Series(samples, interpolate=True).at(at_s) == pytest.approx([interpolated, 1.0], nan_ok=True)


def test_from_and_to_out_of_range_there_is_nothing_between() -> None:
    series = Series([[(0.0, 40.0), (2.0, INF), (4.0, 30.0), (6.0, 20.0)]], interpolate=True)
    assert [series.at(at_s)[0] for at_s in (1.0, 3.0, 5.0, 60.0)] == [40.0, INF, 25.0, 20.0]


def test_of_two_samples_at_one_time_the_last_counts() -> None:
    for interpolate in (False, True):
        assert Series([[(1.0, 3.0), (1.0, 4.0)]], interpolate=interpolate).at(1.0).tolist() == [4.0]


TIMES = st.integers(-50, 50).map(float)
SAMPLES = st.lists(st.tuples(TIMES, st.floats(-200, 60)), min_size=1, max_size=8).map(lambda own: sorted(own))


@given(st.lists(SAMPLES, min_size=1, max_size=5), st.integers(-8000, 8000).map(lambda hundredths: hundredths / 100))
def test_every_link_is_as_if_it_were_alone(samples: list[list[tuple[float, float]]], at_s: float) -> None:
    held = Series(samples, interpolate=False).at(at_s)
    between = Series(samples, interpolate=True).at(at_s)
    for own, value, flowing in zip(samples, held, between, strict=True):
        after = bisect_right([time_s for time_s, _ in own], at_s)
        if after == 0:
            assert np.isnan(value)
            assert np.isnan(flowing)
            continue
        assert value == own[after - 1][1]
        expected = np.interp(at_s, *zip(*own[after - 1 : after + 1], strict=True))
        assert flowing == pytest.approx(float(expected), abs=1e-6)


def test_strengths_of_pairs_without_samples_stay() -> None:
    constant = np.full((3, 3), -INF)
    constant[0, 1], constant[2, 0] = -50.0, -60.0
    strengths = MeasuredStrengths(constant, {(0, 1): [(2.0, -70.0)], (1, 0): [(2.0, -80.0)]}, interpolate=False)
    assert strengths.rssi_dbm(1.0).tolist() == constant.tolist()
    later = strengths.rssi_dbm(2.0)
    assert (later[0, 1], later[1, 0], later[2, 0], later[0, 2]) == (-70.0, -80.0, -60.0, -INF)
