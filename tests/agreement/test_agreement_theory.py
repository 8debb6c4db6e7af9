"""The theory that judges the engines, held against closed forms, enumeration and the definitions."""

from __future__ import annotations

import itertools

import pytest
from agreement_rig import chains, expectations, shapes
from agreement_rig.cells import CELLS, Cell
from agreement_rig.chains import Chain

from netlab.medium.distributions import SCALE, delay_values
from netlab.medium.impairments import (
    Distribution,
    FourStateLoss,
    GilbertElliottLoss,
    Impairment,
    PeriodicLoss,
    RandomLoss,
)


def chain_of(model: RandomLoss | GilbertElliottLoss | FourStateLoss) -> Chain:
    chain = chains.chain_of(model)
    assert chain is not None
    return chain


def test_independent_losses_are_binomial() -> None:
    chain = chain_of(RandomLoss(0.1))
    lost = chains.expected(chain, chains.is_lost)
    assert (lost.mean, lost.variance) == pytest.approx((0.1, 0.09))
    assert chains.expected(chain, chains.starts_burst).mean == pytest.approx(0.1 * 0.9)
    assert chains.expected(chain, chains.is_single).mean == pytest.approx(0.1 * 0.9 * 0.9)


def test_gilbert_losses_have_the_known_mean_variance_and_bursts() -> None:
    p, r = 0.01, 0.25
    chain = chain_of(GilbertElliottLoss(p, r))
    ratio = p / (p + r)
    lost = chains.expected(chain, chains.is_lost)
    assert lost.mean == pytest.approx(ratio)
    assert lost.variance == pytest.approx(ratio * (1 - ratio) * (2 - p - r) / (p + r), rel=1e-4)
    bursts = chains.expected(chain, chains.starts_burst).mean
    assert bursts == pytest.approx((1 - ratio) * p)
    assert chains.expected(chain, chains.is_single).mean == pytest.approx(bursts * r)


def test_four_states_with_gilbert_parameters_are_gilbert() -> None:
    four = chains.expected(chain_of(FourStateLoss(0.02, 0.3, 0.0, 0.4, 0.0)), chains.is_lost)
    two = chains.expected(chain_of(GilbertElliottLoss(0.02, 0.3)), chains.is_lost)
    assert (four.mean, four.variance) == pytest.approx((two.mean, two.variance), rel=1e-4)


def test_isolated_losses_of_four_states_are_all_single() -> None:
    chain = chain_of(FourStateLoss(0.0, 1.0, 0.0, 0.5, 0.1))
    assert chains.expected(chain, chains.is_lost).mean == pytest.approx(0.1 / 1.1)
    assert chains.expected(chain, chains.is_single).mean == pytest.approx(0.1 / 1.1)


def test_independent_receivers_lose_the_product() -> None:
    both = chains.expected_jointly(chain_of(RandomLoss(0.1)))
    assert (both.mean, both.variance) == pytest.approx((0.01, 0.01 * 0.99))


def test_a_chain_that_restarts_equals_the_sum_over_all_its_paths() -> None:
    every, chain = 4, chain_of(GilbertElliottLoss(0.3, 0.4, 0.8, 0.1))
    first = second = 0.0
    for states in itertools.product((0, 1), repeat=every):
        weight = float(states[0] == 0)
        for a, b in itertools.pairwise(states):
            weight *= chain.moves[a][b]
        mean = sum(chain.emission[state] for state in states)
        spread = sum(chain.emission[state] * (1 - chain.emission[state]) for state in states)
        first += weight * mean
        second += weight * (spread + mean * mean)
    found = chains.expected_restarted(chain, every)
    assert found.mean == pytest.approx(first / every)
    assert found.variance == pytest.approx((second - first * first) / every)


def test_a_chain_that_hardly_ever_restarts_is_stationary() -> None:
    chain = chain_of(GilbertElliottLoss(0.02, 0.3))
    restarted, steady = chains.expected_restarted(chain, 400), chains.expected(chain, chains.is_lost)
    assert restarted.mean == pytest.approx(steady.mean, rel=0.02)


def test_theory_says_when_it_does_not_know() -> None:
    assert chains.chain_of(RandomLoss(0.1, correlation=0.2)) is None
    assert chains.chain_of(PeriodicLoss(5)) is None


@pytest.mark.parametrize("distribution", list(Distribution))
def test_the_closed_forms_are_those_of_the_tables(distribution: Distribution) -> None:
    """Two ways to the same shapes; tables are 4096 steps, which matters in the tails only."""
    quantile = shapes.formula(Impairment(delay_s=9.0, jitter_s=1.0, distribution=distribution), 100, 0.0, 0.001)
    assert quantile is not None
    table = delay_values(distribution)
    for share in (0.01, 0.05, 0.25, 0.5, 0.75, 0.95):
        assert quantile(share) - 9.0 == pytest.approx(table[int(share * len(table))] / SCALE, abs=0.01), share


def test_delays_with_frames_sent_at_once_have_a_step() -> None:
    quantile = shapes.formula(Impairment(delay_s=0.01, reorder_ratio=0.2), 100, 0.2, 0.001)
    assert quantile is not None
    assert [quantile(share) for share in (0.1, 0.19, 0.21, 0.9)] == [0.0, 0.0, 0.01, 0.01]


def test_the_line_adds_its_time_and_a_full_one_is_beyond_the_formula() -> None:
    quantile = shapes.formula(Impairment(delay_s=0.005, rate_bps=20e6), 1250, 0.0, 0.001)
    assert quantile is not None
    assert quantile(0.5) == pytest.approx(0.0055)
    assert shapes.formula(Impairment(delay_s=0.005, rate_bps=9e6), 1250, 0.0, 0.001) is None


def test_reordering_by_gap_is_a_renewal_process() -> None:
    cell = Cell("", ((Impairment(delay_s=0.01, reorder_ratio=0.5, reorder_gap=5),),), 100)
    at_once = expectations.theory(cell, cell.phases[0])["sent at once", ""]
    assert at_once.mean == pytest.approx(1 / 6)  # four are delayed, then two on average until one leaves at once
    assert at_once.variance == pytest.approx(2 / 6**3)


def test_duplicates_of_lossy_links_count_as_in_netem() -> None:
    cell = Cell("", ((Impairment(loss=RandomLoss(0.1), duplicate_ratio=0.2),),), 100)
    known = expectations.theory(cell, cell.phases[0])
    assert known["lost", ""].mean == pytest.approx(0.8 * 0.1)
    assert known["copies", ""].mean == pytest.approx(0.2 * 0.9 * 0.9)


def test_names_of_cells_are_distinct() -> None:
    names = [(cell.name, cell.reach) for cell in CELLS]
    assert len(set(names)) == len(names)
