"""Who hears, who defers, who collides, and what is told about it."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from channels import (
    NOISE_DBM,
    SIX,
    STRONG_DBM,
    G,
    channel,
    drain,
    on_air_s,
    saturate,
    strengths,
    verdicts,
    without_retries,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from netlab.medium.phy import PHYS, airtime_s, threshold_db
from netlab.medium.rate_control import AdaptiveRate, FixedRate
from netlab.medium.verdicts import Verdict

NOTHING_DBM = -math.inf


def test_a_group_frame_reaches_all_who_hear_it_once() -> None:
    used = channel(strengths(4, {(0, 1): -50.0, (0, 2): -60.0, (1, 3): -50.0}))
    used.offer(0, bytes(100), None, now=1.0, tag=77)
    (done,) = drain(used)
    assert done.fates == [(1, Verdict.DELIVERED), (2, Verdict.DELIVERED)]
    assert (done.sender, done.attempts, done.tag, done.offered_s) == (0, 1, 77, 1.0)


def test_group_frames_go_at_the_lowest_basic_rate_and_others_at_the_fixed_one() -> None:
    used = channel(strengths(2), rate_control=FixedRate(G.rate(54e6)))
    used.offer(0, bytes(1000), None, now=0.0)
    used.offer(0, bytes(1000), 1, now=0.0)
    assert [done.rate.bps for done in drain(used)] == [6e6, 54e6]


def test_a_group_frame_goes_at_the_rate_that_its_sender_asks_for_and_pays_for_it() -> None:
    weak_dbm = NOISE_DBM + 8  # 6 Mbit/s arrive, 54 do not
    used = channel(strengths(3, {(0, 1): STRONG_DBM, (0, 2): weak_dbm}))
    for rate in (None, G.rate(54e6)):
        for _ in range(50):
            used.offer(0, bytes(1000), None, now=0.0, rate=rate)
    decided = drain(used)
    slow, fast = decided[:50], decided[50:]
    assert {done.rate.bps for done in slow} == {6e6}
    assert {done.rate.bps for done in fast} == {54e6}
    got = [sum((place, Verdict.DELIVERED) in done.fates for done in part) for part in (slow, fast) for place in (1, 2)]
    assert got[0] == got[2] == 50
    assert got[1] > 45
    assert got[3] == 0
    span_s = [part[-1].at_s - part[0].at_s for part in (slow, fast)]
    assert span_s[1] < span_s[0] / 4


def test_rate_control_finds_the_rate_that_the_signal_carries() -> None:
    # 54 Mbit/s needs some 22 dB; at 15 dB QPSK or 16-QAM is what gets through.
    weak_dbm = NOISE_DBM + 15
    used = channel(strengths(2, {(0, 1): weak_dbm}), rate_control=AdaptiveRate(G))
    decided = saturate(used, {0: 1}, for_s=0.5)
    rates = {done.rate.bps for done in decided[-20:]}
    assert max(rates) > 6e6
    assert max(rates) < 54e6
    assert verdicts(decided)["DELIVERED"] == len(decided)


def test_noise_loses_frames_at_the_radios_own_ratio() -> None:
    edge_dbm = NOISE_DBM + threshold_db(SIX, G.psdu_bytes(500), 0.3)
    used = channel(strengths(2, {(0, 1): edge_dbm}))
    for _ in range(3000):
        used.offer(0, bytes(500), None, now=0.0)
    lost = verdicts(drain(used))["LOST"] / 3000
    assert lost == pytest.approx(0.3, abs=0.03)


def test_unicast_frames_are_tried_again_until_they_are_through() -> None:
    edge_dbm = NOISE_DBM + threshold_db(SIX, G.psdu_bytes(500), 0.5)
    matrix = [[NOTHING_DBM, edge_dbm], [STRONG_DBM, NOTHING_DBM]]
    used = channel(matrix)
    for _ in range(2000):
        used.offer(0, bytes(500), 1, now=0.0)
    decided = drain(used)
    assert verdicts(decided)["LOST"] / 2000 == pytest.approx(0.5**7, abs=0.006)
    first = sum(done.attempts == 1 for done in decided) / 2000
    assert first == pytest.approx(0.5, abs=0.04)
    assert {done.attempts for done in decided if done.fates[0][1] is Verdict.LOST} == {7}


def test_a_frame_whose_acknowledgements_are_lost_is_delivered_once() -> None:
    used = channel([[NOTHING_DBM, STRONG_DBM], [NOTHING_DBM, NOTHING_DBM]])
    used.offer(0, bytes(500), 1, now=0.0)
    (done,) = drain(used)
    assert done.fates == [(1, Verdict.DELIVERED)]
    assert done.attempts == 1
    used.advance(10.0)
    assert used.stats.attempts == 7
    assert used.stats.given_up == 1


def test_the_contention_window_doubles_with_every_attempt() -> None:
    used = channel(strengths(2, {}))
    spans_s = []
    for number in range(300):
        start_s = 10.0 * number
        used.advance(start_s)
        used.offer(0, bytes(500), 1, now=start_s)
        spans_s.append(drain(used)[0].at_s - start_s)
    exchange_s = on_air_s(500) + G.sifs_s + G.ack_s(SIX)
    mean_slots = sum(min(16 << k, 1024) - 1 for k in range(7)) / 2
    expected_s = 7 * exchange_s + 6 * G.difs_s + mean_slots * G.slot_s
    assert sum(spans_s) / len(spans_s) == pytest.approx(expected_s, rel=0.05)


def test_stations_that_hear_each_other_hardly_collide_and_hidden_ones_do() -> None:
    flows: dict[int, int | None] = {0: 2, 1: 2}
    phy = without_retries()
    seen = verdicts(saturate(channel(strengths(3), phy=phy), flows, for_s=3.0))
    hidden = channel(strengths(3, {(0, 2): STRONG_DBM, (1, 2): STRONG_DBM}), phy=phy)
    unseen = verdicts(saturate(hidden, flows, for_s=3.0))
    assert seen["COLLISION"] / sum(seen.values()) < 0.15
    assert unseen["COLLISION"] / sum(unseen.values()) > 0.8
    assert seen["LOST"] + unseen["LOST"] == 0


def test_exposed_senders_defer_and_distant_ones_do_not() -> None:
    """1 -> 0 and 2 -> 3: only the senders hear each other, so they take turns though nobody would be disturbed."""
    flows: dict[int, int | None] = {1: 0, 2: 3}
    links = {(0, 1): STRONG_DBM, (2, 3): STRONG_DBM}
    apart = verdicts(saturate(channel(strengths(4, links)), flows, for_s=2.0))["DELIVERED"]
    exposed_links = links | {(1, 2): STRONG_DBM}
    exposed = verdicts(saturate(channel(strengths(4, exposed_links)), flows, for_s=2.0))["DELIVERED"]
    assert exposed == pytest.approx(apart / 2, rel=0.1)


@pytest.mark.parametrize("seed", range(8))
def test_who_hears_only_the_receiver_waits_for_its_acknowledgement(seed: int) -> None:
    links = {(0, 1): STRONG_DBM, (1, 2): STRONG_DBM, (2, 3): STRONG_DBM}
    used = channel(strengths(4, links), seed=seed)
    used.offer(0, bytes(1000), 1, now=0.0)
    ends_s = used.next_event()
    assert ends_s is not None
    while not (decided := used.advance(ends_s)):  # and no further: the acknowledgement is under way
        ends_s += 1e-5
    (first,) = decided
    during_s = first.at_s + G.sifs_s + G.ack_s(SIX) / 2
    used.advance(during_s)
    used.offer(2, bytes(1000), None, now=during_s)
    (second,) = drain(used)
    assert second.at_s >= first.at_s + G.sifs_s + G.ack_s(SIX) + G.difs_s + on_air_s(1000) - 1e-9


def test_who_is_heard_below_the_threshold_is_no_reason_to_wait() -> None:
    faint = strengths(4, {(0, 1): STRONG_DBM, (2, 3): STRONG_DBM, (1, 2): -95.0})
    deaf = channel(faint, phy=replace(G, cca_dbm=-82.0))
    keen = channel(faint, phy=replace(G, cca_dbm=-100.0))
    flows: dict[int, int | None] = {1: 0, 2: 3}
    assert len(saturate(deaf, flows, for_s=1.0)) > 1.8 * len(saturate(keen, flows, for_s=1.0))


def test_the_stronger_of_two_frames_survives() -> None:
    links = {(0, 2): -50.0, (1, 2): -75.0}  # 0 and 1 do not hear each other
    used = channel(strengths(3, links), phy=without_retries())
    decided = saturate(used, {0: 2, 1: 2}, for_s=1.0)
    strong = verdicts(done for done in decided if done.sender == 0)
    weak = verdicts(done for done in decided if done.sender == 1)
    assert set(strong) == {"DELIVERED"}
    assert weak["COLLISION"] > 0.8 * sum(weak.values())


def test_a_short_overlap_does_less_harm_than_a_long_one() -> None:
    """Interference that leaves every second frame intact over the whole length spares most over a part of it."""
    signal_dbm = -70.0
    sinr_db = threshold_db(SIX, G.psdu_bytes(1500), 0.5)
    links = {(0, 1): signal_dbm, (1, 2): signal_dbm - sinr_db}
    shares = []
    for size_bytes in (60, 1500):
        lost = 0
        for number in range(400):
            used = channel(strengths(3, links), phy=without_retries(), seed=number)
            used.offer(0, bytes(1500), None, now=0.0)
            used.offer(2, bytes(size_bytes), None, now=0.0)
            fates = [fate for done in drain(used) if done.sender == 0 for fate in done.fates]
            lost += fates == [(1, Verdict.COLLISION)]
        shares.append(lost / 400)
    assert shares[0] < 0.15
    assert 0.35 < shares[1] < 0.6


def test_a_station_that_transmits_hears_nothing() -> None:
    used = channel(strengths(2, {(0, 1): STRONG_DBM}), phy=replace(G, cca_dbm=0.0))  # nobody defers
    used.offer(0, bytes(1500), None, now=0.0)
    used.offer(1, bytes(1500), None, now=0.0)
    assert verdicts(drain(used)) == {"COLLISION": 2}


def test_who_is_out_of_range_is_told_apart_from_who_is_unlucky() -> None:
    used = channel(strengths(2, {(0, 1): STRONG_DBM}))
    used.set_rssi(strengths(2, {}))
    used.offer(0, bytes(100), None, now=0.0)
    used.offer(0, bytes(100), 1, now=0.0)
    group, single = drain(used)
    assert group.fates == single.fates == [(1, Verdict.OUT_OF_RANGE)]
    assert single.attempts == 7


def test_a_group_frame_says_nothing_of_those_who_never_heard() -> None:
    used = channel(strengths(3, {(0, 1): STRONG_DBM}))
    used.offer(0, bytes(100), None, now=0.0)
    assert drain(used)[0].fates == [(1, Verdict.DELIVERED)]


def test_an_outage_is_silent_and_keeps_the_channel_busy() -> None:
    used = channel(strengths(3))
    used.set_outage({(0, 1)}, active=True)
    used.offer(0, bytes(100), None, now=0.0)
    used.offer(0, bytes(100), 1, now=0.0)
    group, single = drain(used)
    assert group.fates == [(1, Verdict.OUTAGE), (2, Verdict.DELIVERED)]
    assert single.fates == [(1, Verdict.OUTAGE)]
    assert single.attempts == 7
    used.set_outage({(0, 1)}, active=False)
    used.offer(0, bytes(100), 1, now=5.0)
    assert drain(used)[0].fates == [(1, Verdict.DELIVERED)]


def test_a_full_queue_refuses_for_everyone_concerned() -> None:
    used = channel(strengths(3), limit_packets=2)
    assert [used.offer(0, bytes(100), None, now=0.0) for _ in range(2)] == [[], []]
    assert used.offer(0, bytes(100), None, now=0.0) == [(1, Verdict.QUEUE_FULL), (2, Verdict.QUEUE_FULL)]
    assert used.offer(0, bytes(100), 2, now=0.0) == [(2, Verdict.QUEUE_FULL)]
    assert len(drain(used)) == 2
    assert used.offer(0, bytes(100), 2, now=1.0) == []
    assert used.stats.queue_full == 2


def test_a_queue_may_be_limited_in_bytes() -> None:
    used = channel(strengths(2), limit_bytes=250)
    assert [len(used.offer(0, bytes(100), 1, now=0.0)) for _ in range(3)] == [0, 0, 1]
    assert used.offer(0, bytes(50), 1, now=0.0) == []
    assert len(drain(used)) == 3
    assert used.offer(0, bytes(250), 1, now=1.0) == []


def test_a_change_of_strengths_in_mid_frame_leaves_nobody_waiting() -> None:
    used = channel(strengths(3))
    used.offer(0, bytes(1500), 1, now=0.0)
    used.offer(2, bytes(1500), 1, now=0.0)
    used.advance(0.001)  # one of them is on the air
    used.set_rssi(strengths(3, {}))
    used.set_rssi(strengths(3))
    assert verdicts(drain(used)) == {"DELIVERED": 2}


def test_the_luck_of_a_pair_depends_on_its_own_frames_alone() -> None:
    edge_dbm = NOISE_DBM + threshold_db(SIX, G.psdu_bytes(100), 0.5)
    alone = strengths(4, {(0, 1): edge_dbm})
    crowded = strengths(4, {(0, 1): edge_dbm, (0, 2): edge_dbm, (0, 3): STRONG_DBM})
    fates = []
    for matrix, others in ((alone, 0), (crowded, 50)):
        used = channel(matrix)
        for number in range(300):
            used.advance(float(number))
            used.offer(0, bytes(100), None, now=float(number))
            if number < others:
                used.offer(0, bytes(100), 3, now=float(number))
        decided = [done for done in drain(used) if len(done.fates) != 1 or done.fates[0][0] != 3]
        fates.append([dict(done.fates)[1] for done in decided])
    assert fates[0] == fates[1][-len(fates[0]) :]


def test_radios_with_other_numbers_carry_frames_as_well() -> None:
    for phy in PHYS.values():
        used = channel(strengths(2), phy=phy, rate_control=AdaptiveRate(phy))
        used.offer(0, bytes(500), None, now=0.0)
        used.offer(0, bytes(500), 1, now=0.0)
        group, single = drain(used)
        assert group.rate is phy.group_rate
        assert verdicts([group, single]) == {"DELIVERED": 2}
        assert group.at_s >= airtime_s(phy.group_rate, phy.psdu_bytes(500))


@settings(deadline=None)
@given(
    seed=st.integers(0, 1000),
    offers=st.lists(
        st.tuples(
            st.floats(0, 0.02), st.integers(0, 3), st.sampled_from([None, 0, 1, 2, 3]), st.sampled_from([60, 400, 1500])
        ),
        max_size=25,
    ),
    steps=st.lists(st.floats(0, 0.05), max_size=10),
)
def test_when_it_is_asked_changes_nothing_and_every_frame_has_one_end(
    seed: int, offers: list[tuple[float, int, int | None, int]], steps: list[float]
) -> None:
    matrix = strengths(4, {(0, 1): -60.0, (1, 2): -80.0, (2, 3): -87.0, (0, 2): -88.5})
    offers = sorted((offer for offer in offers if offer[1] != offer[2]), key=lambda offer: offer[0])
    told = []
    for extra in ([], steps):
        used, decided = channel(matrix, seed=seed), []
        moments = sorted([(at, None) for at in extra] + [(offer[0], offer) for offer in offers], key=lambda m: m[0])
        for at_s, offer in moments:
            decided += used.advance(at_s)
            if offer is not None:
                used.offer(offer[1], bytes(offer[3]), offer[2], now=at_s)
        decided += drain(used)
        told.append([(d.at_s, d.sender, d.fates, d.attempts, d.offered_s) for d in decided])
    assert told[0] == told[1]
    assert len(told[0]) == len(offers)
    assert all(at_s >= offered_s for at_s, _sender, _fates, _attempts, offered_s in told[0])
    for sender in range(4):
        mine = [offered_s for _at, by, _fates, _attempts, offered_s in told[0] if by == sender]
        assert mine == sorted(mine)
