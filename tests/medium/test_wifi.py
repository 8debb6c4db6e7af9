"""Attempts, retries, acknowledgements and range of 802.11 radios."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.medium.impairments import PERFECT, Impairment, PeriodicLoss, RandomLoss
from netlab.medium.segments import Port, Segment, SegmentKind, Wifi, WifiMode
from netlab.medium.verdicts import Verdict
from netlab.medium.wifi import DEFAULT_RSSI_DBM, Transmission, WifiMedium

GROUP = b"\xff" * 6


def port(index: int) -> Port:
    return Port(index, f"n{index}", "radio0", bytes([2, 0, 0, 0, 0, index]), None)


def medium(
    pairs: dict[tuple[int, int], Impairment], *, tries: int = 7, monitor: bool = False, seed: int = 1
) -> WifiMedium:
    wifi = Wifi(WifiMode.MESH, "test", 2412, tries, monitor)
    segment = Segment("radio", SegmentKind.RADIO, (0, 1, 2), pairs, wifi)
    return WifiMedium([port(0), port(1), port(2)], [segment], seed)


def both(a: int, b: int, impairment: Impairment = PERFECT) -> dict[tuple[int, int], Impairment]:
    return {(a, b): impairment, (b, a): impairment}


def frame(to: int | None, size: int = 60) -> bytes:
    receiver = GROUP if to is None else port(to).mac
    return (b"\x88\x00\x00\x00" + receiver).ljust(size, b".")


def send(radio: WifiMedium, to: int | None, *, now: float = 1.0, ack: bool = True) -> Transmission:
    return radio.transmit(0, frame(to), ack=ack, now=now)


def test_a_perfect_pair_takes_one_attempt_and_is_acknowledged() -> None:
    done = send(medium(both(0, 1)), 1)
    assert (done.attempts, done.acked, done.done_s) == (1, True, 1.0)
    assert done.outcomes == [(1.0, 1, frame(1), Verdict.DELIVERED)]


def test_lost_attempts_are_repeated_until_one_arrives() -> None:
    radio = medium(both(0, 1, Impairment(loss=PeriodicLoss(every=3))))  # frames 0, 3, 6, ... are lost
    assert [send(radio, 1).attempts for _ in range(4)] == [2, 1, 2, 1]


def test_the_retry_limit_ends_it_with_a_loss() -> None:
    done = send(medium(both(0, 1, Impairment(loss=RandomLoss(1.0))), tries=4), 1)
    assert (done.attempts, done.acked, done.outcomes[0][3]) == (4, False, Verdict.LOST)


@pytest.mark.parametrize(("loss", "tries"), [(0.5, 1), (0.5, 3), (0.3, 2), (0.8, 7)])
def test_delivery_and_mean_attempts_are_those_of_independent_tries(loss: float, tries: int) -> None:
    radio, count = medium(both(0, 1, Impairment(loss=RandomLoss(loss))), tries=tries), 20_000
    done = [send(radio, 1) for _ in range(count)]
    arrives = 1 - loss**tries
    within = 2.576 * math.sqrt(arrives * (1 - arrives) / count)
    assert abs(sum(d.acked for d in done) / count - arrives) < within
    expected_attempts = (1 - loss**tries) / (1 - loss)  # of a geometric distribution, cut
    assert sum(d.attempts for d in done) / count == pytest.approx(expected_attempts, rel=0.02)


def test_a_group_frame_is_sent_once_and_each_receiver_draws_its_own_loss() -> None:
    loss = Impairment(loss=RandomLoss(0.5))
    radio = medium({(0, 1): loss, (0, 2): loss})
    patterns = set()
    for _ in range(200):
        done = send(radio, None)
        assert (done.attempts, done.acked) == (1, False)
        assert [outcome[1] for outcome in done.outcomes] == [1, 2]
        patterns.add(tuple(outcome[3] for outcome in done.outcomes))
    assert len(patterns) == 4


def test_out_of_range_and_cut_receivers_cost_every_attempt() -> None:
    radio = medium(both(0, 1))
    assert (send(radio, 2).attempts, send(radio, 2).outcomes[0][3]) == (7, Verdict.OUT_OF_RANGE)
    radio.set_outage({(0, 1)}, active=True)
    assert (send(radio, 1).attempts, send(radio, 1).outcomes[0][3]) == (7, Verdict.OUTAGE)
    radio.set_outage({(0, 1)}, active=False)
    assert send(radio, 1).acked


@pytest.mark.parametrize("how", ["out of range", "cut"])
def test_without_a_way_back_the_frame_arrives_once_and_the_sender_sees_a_failure(how: str) -> None:
    radio = medium({(0, 1): PERFECT} if how == "out of range" else both(0, 1))
    if how == "cut":
        radio.set_outage({(1, 0)}, active=True)
    done = send(radio, 1)
    assert (done.attempts, done.acked) == (7, False)
    assert [outcome[3] for outcome in done.outcomes] == [Verdict.DELIVERED]


def test_a_frame_that_wants_no_acknowledgement_is_tried_once() -> None:
    radio = medium(both(0, 1, Impairment(loss=PeriodicLoss(every=2))))
    assert [send(radio, 1, ack=False).outcomes[0][3] for _ in range(2)] == [Verdict.LOST, Verdict.DELIVERED]
    assert not send(medium(both(0, 1)), 1, ack=False).acked


def test_delay_rate_and_queue_are_the_pairs_and_the_sender_is_done_with_the_arrival() -> None:
    radio = medium(both(0, 1, Impairment(delay_s=0.01, rate_bps=48_000, limit_packets=2)))
    first, second, third = (send(radio, 1) for _ in range(3))
    assert first.done_s == pytest.approx(1.0 + 0.01 + 60 * 8 / 48_000)
    assert second.done_s > first.done_s
    assert third.outcomes[0][3] is Verdict.QUEUE_FULL
    assert (third.attempts, third.done_s) == (1, 1.0)


def test_monitors_overhear_what_is_not_for_them_and_it_counts_for_nobody() -> None:
    radio = medium({**both(0, 1), **both(0, 2)}, monitor=True)
    done = send(radio, 1)
    assert [outcome[1] for outcome in done.overheard] == [2]
    assert sum(radio.counts.values()) == 1
    assert send(medium({**both(0, 1), **both(0, 2)}), 1).overheard == []


def test_strength_is_the_pairs_or_the_default_and_changes_live() -> None:
    radio = medium({(0, 1): Impairment(rssi_dbm=-71.0), (1, 0): PERFECT})
    assert (radio.rssi_dbm(0, 1), radio.rssi_dbm(1, 0), radio.rssi_dbm(0, 2)) == (-71, DEFAULT_RSSI_DBM, -50)
    radio.set_pairs({(0, 1): Impairment(rssi_dbm=-80.0)})
    assert radio.rssi_dbm(0, 1) == -80


def test_a_pair_comes_into_range_and_leaves_again() -> None:
    radio = medium({})
    assert send(radio, None).outcomes == []
    radio.set_pairs({(0, 2): PERFECT})
    assert [outcome[1] for outcome in send(radio, None).outcomes] == [2]
    radio.set_pairs({(0, 2): None})
    assert [outcome[3] for outcome in send(radio, None).outcomes] == [Verdict.OUT_OF_RANGE]


def test_an_unknown_address_is_nobodys_and_counted() -> None:
    radio = medium(both(0, 1))
    done = radio.transmit(0, b"\x88\0\0\0" + bytes.fromhex("020000000099") + bytes(50), ack=True, now=1.0)
    assert (done.outcomes, done.attempts, done.acked, radio.unaddressed) == ([], 7, False, 1)


def test_pairs_of_other_segments_are_refused_and_nothing_changes() -> None:
    radio = medium(both(0, 1))
    for bad in ((0, 0), (0, 7), (9, 1)):
        with pytest.raises(ValueError, match="share no 802"):
            radio.set_pairs({(0, 1): None, bad: PERFECT})
    assert send(radio, 1).acked


@given(st.integers(0, 2**32), st.lists(st.sampled_from([None, 1, 2]), max_size=60))
def test_the_same_seed_decides_the_same_and_group_frames_change_nothing_for_other_pairs(
    seed: int, receivers: list[int | None]
) -> None:
    loss = Impairment(loss=RandomLoss(0.4))
    pairs = {**both(0, 1, loss), **both(0, 2, loss)}

    def fates(to: list[int | None]) -> list[tuple[int, bool]]:
        radio = medium(pairs, tries=3, seed=seed)
        return [(d.attempts, d.acked) for r, d in ((r, send(radio, r)) for r in to) if r == 1]

    assert fates(receivers) == fates(receivers)
    unicast = [r for r in receivers if r is not None]
    assert fates(unicast) == fates([r for r in unicast if r == 1])


def test_draws_do_not_touch_the_global_generator() -> None:
    random.seed(5)
    before = random.getstate()
    send(medium(both(0, 1, Impairment(loss=RandomLoss(0.5)))), 1)
    assert random.getstate() == before
