"""Radios with a phy on netem: which pairs are told to the kernel, and when."""

from __future__ import annotations

import numpy as np
import pytest

from netlab.engines.base import Pair
from netlab.engines.netem_radio import NetemRadios, without_airtime
from netlab.engines.plan import compile_plan
from netlab.medium.impairments import PERFECT, Impairment
from netlab.scenario import parse_scenario

PLAN = compile_plan(
    parse_scenario(
        {
            "duration": "1s",
            "radio": {"phy": "802.11g-20MHz", "rate": "6mbit", "delay": "2ms", "propagation": {"model": "free_space"}},
            "nodes": {"a": {}, "b": {}, "c": {}},
            "links": [{"between": ["a", "b"], "delay": "1ms"}],
        }
    )
)
WIRE = PLAN.segments[0].ports
RADIO = PLAN.segments[1]
A, B, C = RADIO.ports


class Kernel:
    """What an engine of pairs was told."""

    def __init__(self) -> None:
        self.changes: list[dict[Pair, Impairment | None]] = []

    def set_pairs(self, changes: dict[Pair, Impairment | None]) -> None:
        self.changes.append(changes)


@pytest.fixture
def kernel() -> Kernel:
    return Kernel()


@pytest.fixture
def radios(kernel: Kernel) -> NetemRadios:
    return NetemRadios(PLAN, kernel)  # type: ignore[arg-type]


def matrix(ab_dbm: float, ac_dbm: float, bc_dbm: float = -np.inf) -> np.ndarray:
    rssi_dbm = np.full((3, 3), -np.inf)
    for a, b, power in ((0, 1, ab_dbm), (0, 2, ac_dbm), (1, 2, bc_dbm)):
        rssi_dbm[a, b] = rssi_dbm[b, a] = power
    return rssi_dbm


def test_the_kernels_plan_has_no_airtime_and_every_pair_at_the_default_strength() -> None:
    plain = without_airtime(PLAN)
    assert plain.segments[0] is PLAN.segments[0]
    assert plain.segments[1].channel is None
    assert set(plain.segments[1].pairs) == set(RADIO.pairs)
    assert plain.segments[1].pairs[A, B].rate_bps == pytest.approx(5.26e6, rel=0.01)
    assert plain.segments[1].pairs[A, B].delay_s == 0.002


def test_only_pairs_that_have_changed_by_a_decibel_are_told(radios: NetemRadios, kernel: Kernel) -> None:
    radios.set_rssi("radio", matrix(-50.0, -88.0))
    [changes] = kernel.changes
    assert set(changes) == {(A, C), (C, A), (B, C), (C, B)}
    assert changes[B, C] is None
    heard = changes[A, C]
    assert heard is not None
    assert heard.rate_bps is not None
    assert heard.rate_bps < 3e6
    for _ in range(4):
        radios.set_rssi("radio", matrix(-50.3, -88.2))
    assert len(kernel.changes) == 1


def test_every_second_matrix_counts(radios: NetemRadios, kernel: Kernel) -> None:
    radios.set_rssi("radio", matrix(-50.0, -50.0, -50.0))
    assert kernel.changes == []
    radios.set_rssi("radio", matrix(-50.0, -50.0))
    assert kernel.changes == []
    radios.set_rssi("radio", matrix(-50.0, -50.0))
    assert set(kernel.changes[0]) == {(B, C), (C, B)}


def test_words_and_strength_act_together_whichever_comes_last(radios: NetemRadios, kernel: Kernel) -> None:
    radios.set_rssi("radio", matrix(-88.0, -50.0, -50.0))
    weak = kernel.changes[0][A, B]
    radios.set_pairs({(A, B): Impairment(delay_s=0.5), WIRE: PERFECT})
    assert kernel.changes[1] == {WIRE: PERFECT}
    changed = kernel.changes[2][A, B]
    assert weak is not None
    assert changed is not None
    assert (changed.delay_s, changed.rate_bps, changed.loss) == (0.5, weak.rate_bps, weak.loss)
    radios.set_pairs({(A, B): None})
    assert kernel.changes[3] == {(A, B): None}
