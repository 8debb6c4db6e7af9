"""How late departures were."""

from __future__ import annotations

import pytest

from netlab.engines.lateness import Lateness


def test_quantiles_are_right_to_a_step_of_50_us() -> None:
    late = Lateness()
    assert late.quantile_s(0.99) == 0.0
    for number in range(1000):
        late.add(number * 1e-5)
    assert late.max_s == pytest.approx(0.00999)
    assert late.quantile_s(0.5) == pytest.approx(0.005, abs=6e-5)
    assert late.quantile_s(0.99) == pytest.approx(0.0099, abs=6e-5)


def test_a_single_very_late_one_shows_in_the_greatest_only() -> None:
    late = Lateness()
    for _ in range(999):
        late.add(1e-5)
    late.add(7.0)
    assert late.max_s == 7.0
    assert late.quantile_s(0.99) <= 5e-5
    assert late.quantile_s(1.0) >= 1.0
