"""Delay, jitter, correlation, distributions."""

from __future__ import annotations

import itertools
import statistics

import pytest
from media import delays, stream, wire

from netlab.medium.distributions import SCALE, delay_values
from netlab.medium.impairments import Distribution, Impairment

COUNT = 20_000
UNLIMITED = {"limit_packets": None}


def sample(distribution: Distribution, correlation: float = 0.0, jitter_s: float = 0.002) -> list[float]:
    """Delays of a stream around 20 ms."""
    impairment = Impairment(
        delay_s=0.020,
        jitter_s=jitter_s,
        distribution=distribution,
        delay_correlation=correlation,
        limit_packets=None,
    )
    return delays(stream(wire(impairment), COUNT))


def quantile(values: list[float], q: float) -> float:
    return sorted(values)[int(q * len(values))]


def lag_one(values: list[float]) -> float:
    """Correlation of successive values."""
    return statistics.correlation(values[:-1], values[1:])


def test_constant_delay_is_exact() -> None:
    outcomes = stream(wire(Impairment(delay_s=0.020)), 100)
    assert [o[0] for o in outcomes] == [k * 0.001 + 0.020 for k in range(100)]


def test_uniform_jitter_spans_delay_plus_minus_jitter() -> None:
    values = sample(Distribution.UNIFORM)
    assert 0.018 <= min(values) < 0.01802
    assert 0.02198 < max(values) <= 0.022
    assert statistics.fmean(values) == pytest.approx(0.020, abs=5e-5)
    assert statistics.pstdev(values) == pytest.approx(0.002 / 3**0.5, rel=0.02)


def test_normal_jitter_is_one_standard_deviation() -> None:
    values = sample(Distribution.NORMAL)
    assert statistics.fmean(values) == pytest.approx(0.020, abs=5e-5)
    assert statistics.pstdev(values) == pytest.approx(0.002, rel=0.03)
    assert quantile(values, 0.975) == pytest.approx(0.020 + 1.96 * 0.002, rel=0.01)


def test_pareto_quantiles() -> None:
    """Inverse of shape 3, shifted by its mean and scaled by 4/3: x(q) = ((1 - q)^(-1/3) - 1.5) x 4/3."""
    values = sample(Distribution.PARETO)
    for q in (0.1, 0.5, 0.9):
        expected = 0.020 + 0.002 * (((1 - q) ** (-1 / 3)) - 1.5) * 4 / 3
        assert quantile(values, q) == pytest.approx(expected, abs=8e-5), q


def test_paretonormal_is_a_quarter_normal_and_three_quarters_pareto() -> None:
    normal, pareto, mixed = (
        delay_values(d) for d in (Distribution.NORMAL, Distribution.PARETO, Distribution.PARETONORMAL)
    )
    for place in (100, 1000, 2048, 3500):
        assert mixed[place] == pytest.approx((normal[place] + 3 * pareto[place]) / 4, abs=1)
    values = sample(Distribution.PARETONORMAL)
    assert quantile(values, 0.5) == pytest.approx(0.020 + 0.002 * mixed[2048] / SCALE, abs=8e-5)


@pytest.mark.parametrize("distribution", list(Distribution))
def test_correlation_relates_successive_delays_and_keeps_the_distribution(distribution: Distribution) -> None:
    plain, correlated = sample(distribution), sample(distribution, correlation=0.6)
    assert abs(lag_one(plain)) < 0.03
    assert lag_one(correlated) == pytest.approx(0.6, abs=0.12)
    for q in (0.1, 0.5, 0.9):
        assert quantile(correlated, q) == pytest.approx(quantile(plain, q), abs=2.5e-4), q


def test_jitter_beyond_the_delay_never_delivers_into_the_past() -> None:
    impairment = Impairment(delay_s=0.001, jitter_s=0.010, limit_packets=None)
    assert min(delays(stream(wire(impairment), 2000))) >= 0


def test_jitter_reorders_as_netem_does() -> None:
    impairment = Impairment(delay_s=0.020, jitter_s=0.010, limit_packets=None)
    dues = [o[0] for o in stream(wire(impairment), 200)]
    assert any(b < a for a, b in itertools.pairwise(dues))
