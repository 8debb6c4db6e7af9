"""Rate control: the ladder, what a station picks by what it heard, and where the margin settles."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.medium.phy import PHYS, Phy, packet_error_ratio, threshold_db
from netlab.medium.rate_control import REFERENCE_BYTES, AdaptiveRate, FixedRate, RateControl, ladder

G = PHYS["802.11g-20MHz"]


def goodput_bps(phy: Phy, control: RateControl, snr_db: float, rng: random.Random, *, heard_db: float) -> float:
    """Bits acknowledged per second on the air, of 3000 frames of 1500 bytes; ``heard_db`` is what the sender hears."""
    control.heard(0, 1, heard_db)
    bits = seconds = 0.0
    for _ in range(3000):
        for attempt in range(1, phy.retry_limit + 1):
            rate = control.rate(0, 1, attempt)
            acked = rng.random() >= packet_error_ratio(rate, snr_db, REFERENCE_BYTES)
            seconds += 8 * REFERENCE_BYTES / rate.bps
            control.attempted(0, 1, attempt, acked=acked)
            if acked:
                control.heard(0, 1, heard_db)
                bits += 8 * REFERENCE_BYTES
                break
    return bits / seconds


def best_bps(phy: Phy, snr_db: float) -> float:
    return max(rate.bps * (1 - packet_error_ratio(rate, snr_db, REFERENCE_BYTES)) for rate in phy.rates)


def test_the_ladder_of_802_11g_is_all_its_rates() -> None:
    assert ladder(G) == G.rates


@pytest.mark.parametrize("phy", PHYS.values(), ids=PHYS)
def test_a_step_up_the_ladder_is_faster_and_needs_more(phy: Phy) -> None:
    steps = ladder(phy)
    assert [rate.bps for rate in steps] == sorted({rate.bps for rate in steps})
    needs = [threshold_db(rate, REFERENCE_BYTES) for rate in steps]
    assert needs == sorted(needs)


def test_two_streams_are_used_above_the_fastest_single_one() -> None:
    names = [rate.name for rate in ladder(PHYS["802.11n-20MHz-2x2"])]
    assert names[:3] == ["MCS0", "MCS1", "MCS2"]
    assert names[-1] == "MCS15"
    assert "MCS8" not in names


def test_an_unknown_peer_gets_the_lowest_rate_and_a_loud_one_the_highest() -> None:
    control = AdaptiveRate(G)
    assert control.rate(0, 1, 1).name == "6mbit"
    control.heard(0, 1, 40.0)
    assert control.rate(0, 1, 1).name == "54mbit"
    assert control.rate(1, 0, 1).name == "6mbit"
    control.heard(0, 2, -5.0)
    assert control.rate(0, 2, 1).name == "6mbit"


def test_retries_step_down_every_second_attempt() -> None:
    control = AdaptiveRate(G)
    control.heard(0, 1, 40.0)
    assert [control.rate(0, 1, attempt).name for attempt in range(1, 8)] == [
        "54mbit", "54mbit", "48mbit", "48mbit", "36mbit", "36mbit", "24mbit",
    ]  # fmt: skip


def test_a_frame_that_failed_wholly_makes_the_peer_unknown_until_it_is_heard() -> None:
    control = AdaptiveRate(G)
    control.heard(0, 1, 40.0)
    for attempt in range(1, 7):
        control.attempted(0, 1, attempt, acked=False)
    assert control.rate(0, 1, 1).name != "6mbit"
    control.attempted(0, 1, 7, acked=False)
    assert control.rate(0, 1, 1).name == "6mbit"
    control.heard(0, 1, 40.0)
    assert control.rate(0, 1, 1).name == "54mbit"


@pytest.mark.parametrize("snr_db", [2.0, 5.0, 8.0, 11.0, 14.0, 17.0, 20.0, 23.0, 26.0, 35.0])
def test_goodput_is_close_to_that_of_the_best_rate(snr_db: float) -> None:
    got = goodput_bps(G, AdaptiveRate(G), snr_db, random.Random(3), heard_db=snr_db)
    assert got >= 0.75 * best_bps(G, snr_db)


@pytest.mark.parametrize("excess_db", [3.0, 6.0])
def test_a_peer_that_is_heard_too_loud_is_found_out(excess_db: float) -> None:
    """A beacon of 2 W beside a robot of 1 W: the margin makes up for the difference."""
    got = goodput_bps(G, AdaptiveRate(G), 15.0, random.Random(4), heard_db=15.0 + excess_db)
    assert got >= 0.5 * best_bps(G, 15.0)


def test_a_fixed_rate_is_fixed() -> None:
    control = FixedRate(G.rates[2])
    control.heard(0, 1, 50.0)
    control.attempted(0, 1, 7, acked=False)
    assert control.rate(0, 1, 5) is G.rates[2]


@given(
    events=st.lists(
        st.one_of(st.floats(-30, 60), st.tuples(st.integers(1, 7), st.booleans())),
        max_size=60,
    )
)
def test_the_same_history_gives_the_same_rates_and_never_another_stations(
    events: list[float | tuple[int, bool]],
) -> None:
    controls = AdaptiveRate(G), AdaptiveRate(G)
    for control in controls:
        for event in events:
            if isinstance(event, tuple):
                control.attempted(0, 1, event[0], acked=event[1])
            else:
                control.heard(0, 1, event)
    first, second = ([control.rate(0, 1, attempt) for attempt in range(1, 8)] for control in controls)
    assert first == second
    assert controls[0].rate(0, 2, 1).name == "6mbit"
