"""A pair of radios as an impairment of its own: rate, residual loss, range, and the words on top."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.medium.impairments import PERFECT, GilbertElliottLoss, Impairment, RandomLoss
from netlab.medium.pair_radio import TYPICAL_BYTES, as_pair, exchange_s
from netlab.medium.phy import PHYS, packet_error_ratio
from netlab.medium.segments import ChannelSpec

G = PHYS["802.11g-20MHz"]
SIX = ChannelSpec("802.11g-20MHz", rate_bps=6e6)
ADAPTIVE = ChannelSpec("802.11g-20MHz")


def test_a_lone_exchange_takes_what_the_standard_says() -> None:
    """1000 bytes at 6 Mbit/s: DIFS 34, back-off 67.5, frame 1360, SIFS 16, acknowledgement 44 us."""
    assert exchange_s(G, G.rates[0], 1000) * 1e6 == pytest.approx(34 + 67.5 + 1360 + 16 + 44)


def test_a_strong_pair_has_the_goodput_of_a_lone_station_and_no_loss() -> None:
    heard = as_pair(SIX, 30.0, PERFECT)
    assert heard is not None
    assert heard.rate_bps == pytest.approx(8000 / 1521.5e-6)
    assert heard.loss is None
    fast = as_pair(ADAPTIVE, 30.0, PERFECT)
    assert fast is not None
    assert fast.rate_bps == pytest.approx(8000 / exchange_s(G, G.rates[7], 1000))


def test_a_weak_pair_is_slower_by_its_attempts_and_loses_what_seven_do_not_bring() -> None:
    snr_db = 3.0
    error_ratio = packet_error_ratio(G.rates[0], snr_db, TYPICAL_BYTES)
    assert 0.5 < error_ratio < 0.99
    heard = as_pair(SIX, snr_db, PERFECT)
    assert heard is not None
    assert heard.loss == RandomLoss(pytest.approx(error_ratio**7))  # type: ignore[arg-type]
    mean_attempts = sum(k * error_ratio ** (k - 1) * (1 - error_ratio) for k in range(1, 8)) + 7 * error_ratio**7
    assert heard.rate_bps == pytest.approx(8000 / 1521.5e-6 / mean_attempts)


@pytest.mark.parametrize("snr_db", [-math.inf, -5.0, 1.0])
def test_out_of_range_is_out_of_range(snr_db: float) -> None:
    assert as_pair(SIX, snr_db, PERFECT) is None


def test_the_words_act_besides() -> None:
    words = Impairment(delay_s=0.01, loss=RandomLoss(0.1, correlation=0.2), rssi_dbm=-60.0)
    heard = as_pair(SIX, 3.0, words)
    bare = as_pair(SIX, 3.0, PERFECT)
    assert heard is not None
    assert bare is not None
    assert isinstance(bare.loss, RandomLoss)
    assert heard.loss == RandomLoss(pytest.approx(1 - 0.9 * (1 - bare.loss.loss_ratio)), correlation=0.2)  # type: ignore[arg-type]
    assert (heard.delay_s, heard.rssi_dbm, heard.limit_packets) == (0.01, None, 64)
    bursts = GilbertElliottLoss(0.01, 0.25)
    kept = as_pair(SIX, 3.0, Impairment(loss=bursts))
    assert kept is not None
    assert kept.loss == bursts


@given(snr_db=st.integers(-10, 50), spec=st.sampled_from([SIX, ADAPTIVE, ChannelSpec("802.11n-20MHz-2x2")]))
def test_more_signal_never_carries_less(snr_db: int, spec: ChannelSpec) -> None:
    assert goodput_bps(as_pair(spec, snr_db + 1, PERFECT)) >= goodput_bps(as_pair(spec, snr_db, PERFECT)) * (1 - 1e-9)


def goodput_bps(heard: Impairment | None) -> float:
    if heard is None:
        return 0.0
    assert heard.rate_bps is not None
    assert heard.loss is None or isinstance(heard.loss, RandomLoss)
    return heard.rate_bps * (1 - (heard.loss.loss_ratio if heard.loss else 0.0))
