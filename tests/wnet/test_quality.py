"""The paper's mappings, each beside its equation, and the other metrics."""

from __future__ import annotations

import math

import pytest

from wnet.config import MeshConfig, Metric
from wnet.core.loss import LossEstimate, SequenceWindow
from wnet.core.quality import (
    WORST_QUALITY,
    ett_s,
    etx,
    geometric_mean,
    link_cost,
    link_quality,
    sigmoid_quality,
    signal_quality,
)
from wnet.core.rates import fastest, needed_snr_db
from wnet.core.wire_control import Attributes

PAPER = MeshConfig()


def test_equation_1_is_the_weighted_geometric_mean() -> None:
    assert geometric_mean([(0.5, 1.0), (0.125, 1.0)]) == pytest.approx(0.25)
    assert geometric_mean([(0.5, 2.0), (0.25, 1.0)]) == pytest.approx((0.5**2 * 0.25) ** (1 / 3))
    assert geometric_mean([(0.5, 1.0), (0.001, 0.0)]) == pytest.approx(0.5)
    assert geometric_mean([]) == 1.0


def test_equation_2_reacts_to_weak_signals_strongly_and_to_strong_ones_little() -> None:
    assert signal_quality(0.0, scale_db=10.0) == 0.0
    assert signal_quality(-5.0, scale_db=10.0) == 0.0
    assert signal_quality(10.0, scale_db=10.0) == pytest.approx(1 - math.exp(-1))
    weak = signal_quality(6.0, scale_db=10.0) - signal_quality(3.0, scale_db=10.0)
    strong = signal_quality(43.0, scale_db=10.0) - signal_quality(40.0, scale_db=10.0)
    assert weak > 20 * strong > 0


def test_equation_3_ages_the_loss_of_a_silent_interval() -> None:
    estimate = LossEstimate()
    estimate.close_interval()
    assert estimate.ratio == 0.5
    estimate.close_interval()
    assert estimate.ratio == 0.75


def test_loss_is_counted_by_gaps_in_the_sequence() -> None:
    estimate, window = LossEstimate(), SequenceWindow()
    for sequence in range(65500, 65500 + 800, 4):  # three of four lost, over the wrap
        estimate.count(window.take(sequence & 0xFFFF))
    estimate.close_interval()
    assert estimate.ratio == pytest.approx(0.75, abs=0.02)


def test_a_late_frame_fills_its_gap_and_a_second_copy_is_told() -> None:
    window = SequenceWindow()
    assert [window.take(n) for n in (10, 11, 14, 12, 12, 14, 13, 15)] == [1, 1, 3, 0, -1, -1, 0, 1]


def test_a_restarted_sender_begins_anew() -> None:
    window = SequenceWindow()
    window.take(40000)
    assert window.take(3) == 1
    assert window.take(4) == 1


@pytest.mark.parametrize(("base", "steepness"), [(1e6, 4.0), (100.0, 10.0)])
def test_equation_4_is_high_up_to_its_threshold_and_falls_steeply_behind_it(base: float, steepness: float) -> None:
    at = [sigmoid_quality(x / steepness, base=base, steepness=steepness) for x in (0.0, 0.5, 1.0, 1.5)]
    assert at[0] >= 0.99 * (1 / (1 + 1 / base))
    assert at[1] > 0.9
    assert at[2] == pytest.approx(0.5)
    assert at[3] < 0.1
    assert sigmoid_quality(1.0, base=1e12, steepness=1000.0) >= 0.0  # no overflow


def test_a_link_without_a_signal_goes_by_its_loss() -> None:
    lossless = Attributes(0.0, None, None)
    assert link_quality(lossless, 0.0, 0.0, PAPER) == pytest.approx(1.0, abs=1e-5)
    weak = Attributes(0.0, 3.0, None)
    expected = math.sqrt(signal_quality(3.0, scale_db=10.0))
    assert link_quality(weak, 0.0, 0.0, PAPER) == pytest.approx(expected, rel=1e-4)
    assert link_quality(Attributes(1.0, -20.0, None), 1.0, 1.0, PAPER) == WORST_QUALITY


def test_utilisation_of_both_ends_counts_where_it_is_weighed() -> None:
    config = MeshConfig(utilisation_weight=1.0)
    told = Attributes(0.0, None, None)
    idle, one, both = (link_quality(told, *ends, config) for ends in ((0, 0), (0.2, 0), (0.2, 0.2)))
    assert idle > one > both
    assert link_quality(told, 0.2, 0.2, PAPER) == link_quality(told, 0.0, 0.0, PAPER)


def test_etx_and_ett() -> None:
    assert etx(0.5, 0.0) == 2.0
    assert etx(0.5, 0.5) == 4.0
    assert ett_s(0.0, 0.0, 8_000_000) == pytest.approx(0.001)
    assert ett_s(0.5, 0.0, 8_000_000) == pytest.approx(0.002)


def test_the_metric_decides_what_a_link_costs() -> None:
    slow, fast = Attributes(0.0, 30.0, 6_000_000), Attributes(0.0, 30.0, 54_000_000)
    costs = {m: [link_cost(a, a, 0.5, m) for a in (slow, fast)] for m in Metric}
    assert costs[Metric.QUALITY] == [2.0, 2.0]
    assert costs[Metric.ETX] == [1.0, 1.0]
    assert costs[Metric.ETT][0] == pytest.approx(9 * costs[Metric.ETT][1])


def test_the_fastest_rate_that_a_signal_carries() -> None:
    rates = (6_000_000, 12_000_000, 24_000_000, 54_000_000)
    assert [fastest(rates, snr) for snr in (-3.0, 8.0, 12.0, 17.0, 40.0)] == [
        6_000_000,
        6_000_000,
        12_000_000,
        24_000_000,
        54_000_000,
    ]
    assert fastest((), 40.0) is None
    assert needed_snr_db(144_400_000) == pytest.approx(needed_snr_db(72_200_000) + 3.0)
