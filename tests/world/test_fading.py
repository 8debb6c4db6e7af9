"""Fading: its statistics, its correlation over distance and time, and what it may depend on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from netlab.world.fading import Fading, FadingSettings

WAVELENGTH_M = 0.123
FAST = FadingSettings(rice_k_db=6.0, drift_hz=0.0)
SLOW = FadingSettings(shadowing_db=6.0, shadowing_distance_m=10.0)


def radios(count: int, settings: FadingSettings, *, seed: int = 1, prefix: str = "n") -> Fading:
    return Fading([f"{prefix}{k}" for k in range(count)], np.full(count, WAVELENGTH_M), settings, seed=seed)


def gains_db(fading: Fading, positions_m: np.ndarray, *, in_sight: bool = False, at_s: float = 0.0) -> np.ndarray:
    """Of every pair once; nobody's distance changes."""
    count = len(positions_m)
    matrix = fading.gain_db(positions_m, np.full((count, count), 50.0), np.full((count, count), in_sight), at_s)
    return matrix[np.triu_indices(count, k=1)]


def scattered(count: int, *, seed: int, spread_m: float = 100.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, spread_m, (count, 3))


def powers(settings: FadingSettings, *, in_sight: bool) -> np.ndarray:
    """Of 1225 pairs at 20 places each."""
    fading = radios(50, settings)
    return np.concatenate([10 ** (gains_db(fading, scattered(50, seed=k), in_sight=in_sight) / 10) for k in range(20)])


def test_the_mean_power_is_kept() -> None:
    assert powers(FAST, in_sight=False).mean() == pytest.approx(1.0, abs=0.02)
    assert powers(FAST, in_sight=True).mean() == pytest.approx(1.0, abs=0.02)


def test_behind_a_corner_power_is_exponential() -> None:
    """Rayleigh fading: P(power < x) = 1 - exp(-x)."""
    power = powers(FAST, in_sight=False)
    for limit in (0.01, 0.1, 0.5, 1.0, 2.0, 4.0):
        assert (power < limit).mean() == pytest.approx(1 - math.exp(-limit), rel=0.15, abs=0.01)


def test_in_line_of_sight_the_k_factor_is_the_one_asked_for() -> None:
    """Greenstein, Michelson and Erceg, 1999: K from the power's variance: var / mean^2 = (2 K + 1) / (K + 1)^2."""
    power = powers(FAST, in_sight=True)
    k = 10**0.6
    assert power.var() / power.mean() ** 2 == pytest.approx((2 * k + 1) / (k + 1) ** 2, rel=0.1)


def test_the_fade_decorrelates_over_four_tenths_of_a_wavelength() -> None:
    """Clarke: the power's autocorrelation is J0^2, 1/2 at 0.18 wavelengths and 0 at 0.383."""
    fading, start = radios(50, FAST), scattered(50, seed=3)
    moved = {part: start.copy() for part in (0.02, 0.18, 0.383)}
    for part, positions in moved.items():
        positions[:25, 0] += part * WAVELENGTH_M  # the first of each pair that is looked at
    across = np.array([(i < 25) != (j < 25) for i, j in zip(*np.triu_indices(50, k=1), strict=True)])
    before = 10 ** (gains_db(fading, start) / 10)[across]
    correlation = {}
    for part, positions in moved.items():
        after = 10 ** (gains_db(fading, positions) / 10)[across]
        correlation[part] = np.corrcoef(before, after)[0, 1]
    assert correlation[0.02] > 0.95
    assert correlation[0.18] == pytest.approx(0.5, abs=0.12)
    assert abs(correlation[0.383]) < 0.12


def test_both_ends_moving_decorrelate_it_faster() -> None:
    """Akki and Haber: J0 of each end, multiplied."""
    fading, start = radios(50, FAST), scattered(50, seed=3)
    moved = start + np.array([0.18 * WAVELENGTH_M, 0, 0])
    correlation = np.corrcoef(10 ** (gains_db(fading, start) / 10), 10 ** (gains_db(fading, moved) / 10))[0, 1]
    assert correlation == pytest.approx(0.25, abs=0.12)


def test_radios_at_rest_drift_slowly() -> None:
    fading, here = radios(50, FadingSettings(rice_k_db=6.0, drift_hz=0.1)), scattered(50, seed=5)
    first, soon, later = (10 ** (gains_db(fading, here, at_s=at_s) / 10) for at_s in (0.0, 0.1, 30.0))
    assert np.corrcoef(first, soon)[0, 1] > 0.97
    assert abs(np.corrcoef(first, later)[0, 1]) < 0.15
    still = radios(50, FAST)
    assert np.array_equal(gains_db(still, here, at_s=0.0), gains_db(still, here, at_s=500.0))


def test_shadowing_is_gaussian_in_decibels_with_the_given_spread() -> None:
    fading = radios(50, SLOW)
    gains = np.concatenate([gains_db(fading, scattered(50, seed=k, spread_m=3000)) for k in range(20)])
    assert gains.mean() == pytest.approx(0.0, abs=0.2)
    assert gains.std() == pytest.approx(6.0, rel=0.03)
    for sigmas, share in ((1, 0.683), (2, 0.954)):
        assert (np.abs(gains) < sigmas * 6.0).mean() == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize("moved_m", [1.0, 5.0, 10.0, 20.0])
def test_shadowing_decorrelates_as_gudmundson_says(moved_m: float) -> None:
    """exp(-d / D) when one end moves by d."""
    fading, start = radios(50, SLOW), scattered(50, seed=7)
    positions = start.copy()
    positions[:25] += np.array([0.6, 0.8, 0.0]) * moved_m
    across = np.array([(i < 25) != (j < 25) for i, j in zip(*np.triu_indices(50, k=1), strict=True)])
    before, after = gains_db(fading, start)[across], gains_db(fading, positions)[across]
    assert np.mean(before * after) / np.mean(before**2) == pytest.approx(math.exp(-moved_m / 10), abs=0.1)


def test_it_is_the_same_both_ways_and_nothing_on_the_diagonal() -> None:
    both = FadingSettings(shadowing_db=4.0, rice_k_db=3.0)
    matrix = radios(6, both).gain_db(scattered(6, seed=1), np.full((6, 6), 9.0), np.full((6, 6), True), 3.0)
    assert np.array_equal(matrix, matrix.T)
    assert not matrix.diagonal().any()
    assert np.isfinite(matrix).all()


def test_a_pairs_fading_depends_on_seed_names_places_and_time_alone() -> None:
    """Neither on who else is there, nor on the order in which the radios are listed."""
    settings = FadingSettings(shadowing_db=4.0, rice_k_db=3.0)
    places = dict(zip("abcde", scattered(5, seed=2), strict=True))

    def gain(names: str, *, seed: int = 1) -> float:
        count = len(names)
        fading = Fading(list(names), np.full(count, WAVELENGTH_M), settings, seed=seed)
        positions = np.array([places[name] for name in names])
        matrix = fading.gain_db(positions, np.full((count, count), 9.0), np.full((count, count), True), 3.0)
        return float(matrix[names.index("b"), names.index("d")])

    assert gain("bd") == gain("abcde") == gain("edcba") == gain("db")
    assert gain("bd") != gain("bd", seed=2)


def test_whoever_comes_back_finds_the_same_fade() -> None:
    fading = radios(3, FadingSettings(shadowing_db=4.0, rice_k_db=3.0, drift_hz=0.0))
    here = scattered(3, seed=4)
    first = gains_db(fading, here)
    assert not np.allclose(first, gains_db(fading, here + 1.0))
    assert np.array_equal(first, gains_db(fading, here, at_s=77.0))


def test_without_settings_nothing_fades() -> None:
    assert not gains_db(radios(4, FadingSettings()), scattered(4, seed=1)).any()
    assert radios(1, FAST).gain_db(np.zeros((1, 3)), np.zeros((1, 1)), np.ones((1, 1), bool), 0.0).shape == (1, 1)
