"""Every loss model against its theory, with fixed seeds and bounds of several standard deviations."""

from __future__ import annotations

import itertools
import math

import pytest
from media import lost, stream, wire

from netlab.medium.impairments import (
    FourStateLoss,
    GilbertElliottLoss,
    Impairment,
    LossModel,
    PeriodicLoss,
    RandomLoss,
    TraceLoss,
)

COUNT = 40_000


def losses(model: LossModel, count: int = COUNT, seed: int = 1) -> list[bool]:
    """Which of ``count`` frames are lost."""
    return lost(stream(wire(Impairment(loss=model), seed=seed), count))


def bursts(pattern: list[bool]) -> list[int]:
    """Lengths of the runs of losses."""
    return [len(list(run)) for is_lost, run in itertools.groupby(pattern) if is_lost]


@pytest.mark.parametrize("ratio", [0.001, 0.05, 0.5, 0.99])
def test_random_loss_is_binomial(ratio: float) -> None:
    bound = 3.3 * math.sqrt(ratio * (1 - ratio) / COUNT)
    assert sum(losses(RandomLoss(ratio))) / COUNT == pytest.approx(ratio, abs=bound)


@pytest.mark.parametrize(("ratio", "expected"), [(0.0, 0), (1.0, COUNT)])
def test_random_loss_at_its_ends(ratio: float, expected: int) -> None:
    assert sum(losses(RandomLoss(ratio))) == expected


def test_random_loss_has_no_memory() -> None:
    pattern = losses(RandomLoss(0.3))
    after_loss = [b for a, b in itertools.pairwise(pattern) if a]
    assert sum(after_loss) / len(after_loss) == pytest.approx(0.3, abs=0.015)


def test_correlated_loss_comes_in_bursts_and_is_rarer_below_one_half() -> None:
    """As the kernel's get_crandom: the moving average crowds around 1/2 and remembers."""
    pattern = losses(RandomLoss(0.3, correlation=0.5))
    ratio = sum(pattern) / COUNT
    after_loss = [b for a, b in itertools.pairwise(pattern) if a]
    assert 0.1 < ratio < 0.25
    assert sum(after_loss) / len(after_loss) > 1.5 * ratio


def test_correlated_loss_agrees_with_a_direct_simulation_of_the_kernel_formula() -> None:
    import random

    rng, last, hits = random.Random(99), 0.5, 0
    for _ in range(COUNT):
        last = rng.random() * 0.6 + last * 0.4
        hits += last < 0.2
    assert sum(losses(RandomLoss(0.2, correlation=0.4))) / COUNT == pytest.approx(hits / COUNT, abs=0.01)


def test_gilbert_bursts_have_mean_one_over_r_and_the_stationary_ratio() -> None:
    pattern = losses(GilbertElliottLoss(p=0.02, r=0.25))
    assert sum(pattern) / COUNT == pytest.approx(0.02 / 0.27, rel=0.12)
    lengths = bursts(pattern)
    assert sum(lengths) / len(lengths) == pytest.approx(4.0, rel=0.1)


def test_gilbert_elliott_loses_by_the_state() -> None:
    pattern = losses(GilbertElliottLoss(p=0.1, r=0.3, loss_in_bad=0.6, loss_in_good=0.05))
    assert sum(pattern) / COUNT == pytest.approx(0.25 * 0.6 + 0.75 * 0.05, rel=0.06)


def test_four_states_with_gilbert_parameters_equal_gilbert() -> None:
    """With p32 = p23 = p14 = 0 only states 1 and 3 remain."""
    pattern = losses(FourStateLoss(p13=0.02, p31=0.25, p32=0.0, p23=0.0, p14=0.0))
    assert sum(pattern) / COUNT == pytest.approx(0.02 / 0.27, rel=0.12)


def test_four_states_isolated_losses() -> None:
    """State 4 lasts one frame: losses never touch, ratio p14 / (1 + p14)."""
    pattern = losses(FourStateLoss(p13=0.0, p31=1.0, p32=0.0, p23=0.0, p14=0.1))
    assert set(bursts(pattern)) == {1}
    assert sum(pattern) / COUNT == pytest.approx(0.1 / 1.1, rel=0.06)


def test_four_states_stationary_ratio_with_bursts_that_have_holes() -> None:
    """Balance of 1 -> 3, 3 -> 1, 3 -> 2, 2 -> 3: pi3 = p13 pi1 / p31, pi2 = p32 pi3 / p23."""
    p13, p31, p32, p23 = 0.05, 0.2, 0.3, 0.5
    weights = 1.0, p13 / p31, p13 / p31 * p32 / p23
    pattern = losses(FourStateLoss(p13=p13, p31=p31, p32=p32, p23=p23, p14=0.0))
    assert sum(pattern) / COUNT == pytest.approx(weights[1] / sum(weights), rel=0.1)


def test_periodic_loss() -> None:
    pattern = losses(PeriodicLoss(every=5, offset=2), 20)
    assert [k for k, is_lost in enumerate(pattern) if is_lost] == [2, 7, 12, 17]


def test_trace_loss_repeats() -> None:
    assert losses(TraceLoss((True, False, False)), 7) == [True, False, False, True, False, False, True]


def test_a_change_of_ratio_does_not_end_a_burst() -> None:
    """A robot that moves changes the impairment at every tick; the bad state must survive it."""
    medium = wire(Impairment(loss=GilbertElliottLoss(p=1.0, r=0.0)))
    stream(medium, 3)
    medium.set_pairs({(0, 1): Impairment(loss=GilbertElliottLoss(p=0.0, r=0.0))})
    assert all(lost(stream(medium, 100, start=1.0)))


def test_a_change_of_ratio_does_not_restart_a_period() -> None:
    medium = wire(Impairment(loss=PeriodicLoss(every=4, offset=3)))
    stream(medium, 2)
    medium.set_pairs({(0, 1): Impairment(loss=PeriodicLoss(every=4, offset=3), delay_s=0.001)})
    assert lost(stream(medium, 2)) == [False, True]
