"""Airtime, packet errors and rates of the radios, against the standard's arithmetic and published curves."""

from __future__ import annotations

import math
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.medium.bit_errors import Code, Coded, Modulation, Uncoded
from netlab.medium.phy import ACK_BYTES, PHYS, Rate, airtime_s, packet_error_ratio, threshold_db

G = PHYS["802.11g-20MHz"]
N1, N2 = PHYS["802.11n-20MHz-1x1"], PHYS["802.11n-20MHz-2x2"]
SUBT = PHYS["subt"]
ALL_RATES = [rate for phy in PHYS.values() for rate in phy.rates]


def crossing_db(rate: Rate, size_bytes: int) -> float:
    return threshold_db(rate, size_bytes, 0.5)


@pytest.mark.parametrize(
    ("mbps", "size", "airtime_us"),
    [
        # IEEE 802.11-2016, 17.4.3: 16 + 4 + 4 ceil((22 + 8 L) / N_DBPS), by hand.
        (6, 14, 44),
        (6, 1500, 2024),
        (12, 14, 32),
        (24, 14, 28),
        (54, 1500, 244),
        (54, 1, 24),
    ],
)
def test_ofdm_airtime_is_the_standards(mbps: int, size: int, airtime_us: float) -> None:
    assert airtime_s(G.rate(mbps * 1e6), size) * 1e6 == pytest.approx(airtime_us)


@given(size=st.integers(1, 4000), rate=st.sampled_from(G.rates))
def test_ofdm_airtime_is_the_formula_in_microseconds(size: int, rate: Rate) -> None:
    hundreds = rate.bps / 1e5  # R of the formula 16 + 4 + 4 ceil(10 (22 + 8 L) / (4 R))
    assert airtime_s(rate, size) * 1e6 == pytest.approx(20 + 4 * math.ceil(10 * (22 + 8 * size) / (4 * hundreds)))


@pytest.mark.parametrize(
    ("phy", "index", "mbps", "airtime_us"),
    [
        # IEEE 802.11-2016, 19.4.3: mixed format, 36 us of preamble for one stream and 40 for two, N_DBPS of tables
        # 19-27 and 19-28; 1500 bytes are 12022 bits with service and tail.
        (N1, 0, 6.5, 36 + 4 * 463),
        (N1, 7, 65, 36 + 4 * 47),
        (N2, 7, 65, 36 + 4 * 47),
        (N2, 8, 13, 40 + 4 * 232),
        (N2, 15, 130, 40 + 4 * 24),
    ],
)
def test_ht_airtime_and_rate_are_the_standards(phy: object, index: int, mbps: float, airtime_us: float) -> None:
    assert phy in (N1, N2)
    rate = (N1 if phy is N1 else N2).rates[index]
    assert (rate.name, rate.index) == (f"MCS{index}", index)
    assert rate.bps == pytest.approx(mbps * 1e6)
    assert airtime_s(rate, 1500) * 1e6 == pytest.approx(airtime_us)


def test_the_rates_of_the_ladders() -> None:
    assert [rate.bps / 1e6 for rate in G.rates] == [6, 9, 12, 18, 24, 36, 48, 54]
    assert [rate.bps / 1e6 for rate in N1.rates] == [6.5, 13, 19.5, 26, 39, 52, 58.5, 65]
    assert [rate.bps / 1e6 for rate in N2.rates[8:]] == [13, 26, 39, 52, 78, 104, 117, 130]
    assert [rate.bps / 1e6 for rate in N2.basic] == [6, 12, 24]


def test_the_times_of_medium_access() -> None:
    assert (G.slot_s, G.sifs_s) == (9e-6, 16e-6)
    assert G.difs_s == pytest.approx(34e-6)
    assert (G.cw_min, G.cw_max, G.retry_limit) == (15, 1023, 7)


def test_acknowledgements_go_at_the_highest_mandatory_rate_below_the_frames() -> None:
    assert [G.ack_rate(rate).bps / 1e6 for rate in G.rates] == [6, 6, 12, 12, 24, 24, 24, 24]
    assert N1.ack_rate(N1.rates[0]).name == "6mbit"
    assert N2.ack_rate(N2.rates[15]).name == "24mbit"
    assert G.ack_s(G.rates[-1]) == airtime_s(G.rates[4], ACK_BYTES)


def test_an_ethernet_frame_grows_by_its_802_11_header() -> None:
    assert G.psdu_bytes(14 + 1500) == 24 + 8 + 1500 + 4
    assert N1.psdu_bytes(14 + 1500) == 26 + 8 + 1500 + 4


@pytest.mark.parametrize(
    ("modulation", "snr", "source"),
    [
        (Modulation.BPSK, 4.0, 0.5 * math.erfc(2.0)),
        (Modulation.QPSK, 8.0, 0.5 * math.erfc(2.0)),
        (Modulation.QAM16, 40.0, 3 / 8 * math.erfc(2.0)),
        (Modulation.QAM64, 168.0, 7 / 24 * math.erfc(2.0)),
    ],
)
def test_demodulated_bits_err_as_in_the_nist_model(modulation: Modulation, snr: float, source: float) -> None:
    assert modulation.bit_error_ratio(snr) == pytest.approx(source)


def test_decoded_bits_err_by_the_first_terms_of_their_spectrum() -> None:
    p = 1e-4  # so small that the later terms hardly count
    d = math.sqrt(4 * p * (1 - p))
    assert Code.HALF.decoded_error_ratio(p) == pytest.approx((36 * d**10 + 211 * d**12) / 2, rel=0.01)
    assert Code.TWO_THIRDS.decoded_error_ratio(p) == pytest.approx((3 * d**6 + 70 * d**7 + 285 * d**8) / 4, rel=0.02)
    assert Code.THREE_QUARTERS.decoded_error_ratio(p) == pytest.approx(
        (42 * d**5 + 201 * d**6 + 1492 * d**7) / 6, rel=0.01
    )
    assert Code.FIVE_SIXTHS.decoded_error_ratio(p) == pytest.approx(
        (92 * d**4 + 528 * d**5 + 8694 * d**6) / 10, rel=0.05
    )


def test_half_of_the_kilobytes_err_where_the_nist_curves_say() -> None:
    assert crossing_db(G.rate(6e6), 1024) == pytest.approx(3.5, abs=0.3)
    assert crossing_db(G.rate(12e6), 1024) == pytest.approx(6.5, abs=0.3)


#: Delivered 128-byte frames in percent by ratio in dB, of EMANE's curves for 802.11a/g.
EMANE_6 = {-1: 5.5, 0: 39.8, 1: 79.0, 2: 96.0, 3: 99.5}
EMANE_54 = {20: 32.0, 21: 71.0, 22: 92.0}


@pytest.mark.parametrize(("mbps", "curve", "least_db", "most_db"), [(6, EMANE_6, 0.8, 3.4), (54, EMANE_54, -0.3, 1.2)])
def test_the_bound_beside_emanes_curves(mbps: int, curve: dict[int, float], least_db: float, most_db: float) -> None:
    """How much more signal the union bound asks for than EMANE's curves do, at the same delivery."""
    rate = G.rate(mbps * 1e6)
    for snr_db, percent in curve.items():
        assert least_db < threshold_db(rate, 128, 1 - percent / 100) - snr_db < most_db


@given(size=st.integers(1, 3000), snr_db=st.floats(-30, 60), rate=st.sampled_from(ALL_RATES))
def test_more_signal_never_hurts_and_more_bytes_never_help(size: int, snr_db: float, rate: Rate) -> None:
    ratio = packet_error_ratio(rate, snr_db, size)
    assert 0 <= ratio <= 1
    assert packet_error_ratio(rate, snr_db + 0.5, size) <= ratio <= packet_error_ratio(rate, snr_db, size + 1)


@given(first=st.integers(1, 1500), rest=st.integers(1, 1500), snr_db=st.floats(-5, 30), rate=st.sampled_from(ALL_RATES))
def test_the_parts_of_a_frame_err_as_the_whole(first: int, rest: int, snr_db: float, rate: Rate) -> None:
    parts = (1 - packet_error_ratio(rate, snr_db, first)) * (1 - packet_error_ratio(rate, snr_db, rest))
    assert parts == pytest.approx(1 - packet_error_ratio(rate, snr_db, first + rest), abs=1e-12)


@pytest.mark.parametrize("receiver", [Coded(Modulation.BPSK, Code.HALF), Coded(Modulation.QAM64, Code.FIVE_SIXTHS)])
def test_the_table_is_the_formula_within_two_percent(receiver: Coded) -> None:
    rate = Rate(0, "x", 1e6, receiver, 24, 0.0)
    for step in range(1, 400):
        snr_db = 0.0731 * step
        exact = receiver.bit_error_ratio(10 ** (snr_db / 10))
        if 1e-15 < exact < 0.5:
            assert packet_error_ratio(rate, snr_db, 1 / 8) == pytest.approx(exact, rel=0.02)


def test_subt_bits_err_by_its_own_formula_and_packets_by_their_bits() -> None:
    """osrf/subt: BER = erfc(sqrt(P/N)); a packet of L bytes has 8 L bits."""
    rate = SUBT.rates[0]
    snr = 10 ** (9.0 / 10)
    assert Uncoded().bit_error_ratio(snr) == pytest.approx(math.erfc(math.sqrt(snr)))
    expected = 1 - (1 - math.erfc(math.sqrt(snr))) ** (8 * 500)
    assert packet_error_ratio(rate, 9.0, 500) == pytest.approx(expected, rel=1e-3)
    assert airtime_s(rate, 1250) == pytest.approx(0.01)


def test_two_antennas_gain_three_db_for_one_stream_and_two_streams_cost_three() -> None:
    mrc = crossing_db(N1.rates[3], 1024) - crossing_db(N2.rates[3], 1024)
    split = crossing_db(N2.rates[11], 1024) - crossing_db(N1.rates[3], 1024)
    assert mrc == pytest.approx(3.01, abs=0.01)
    assert split == pytest.approx(3.01, abs=0.01)


def test_a_rate_is_found_by_its_bits_and_of_two_the_one_that_needs_less() -> None:
    assert N2.rate(13e6).name == "MCS1"
    with pytest.raises(ValueError, match=r"no rate of 7mbit; its rates are 6mbit, 9mbit, 12mbit"):
        G.rate(7e6)


def test_a_phy_survives_the_way_to_another_process() -> None:
    copy = pickle.loads(pickle.dumps(G))
    assert [rate.name for rate in copy.rates] == [rate.name for rate in G.rates]
    assert copy.basic[0] is copy.rates[0]
    assert packet_error_ratio(copy.rates[2], 6.0, 500) == packet_error_ratio(G.rates[2], 6.0, 500)
