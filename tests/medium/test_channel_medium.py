"""A shared channel as a segment of the medium: addresses, words on top, changes, counters."""

from __future__ import annotations

import numpy as np
import pytest
from media import frame, port

from netlab.medium.impairments import PERFECT, Impairment, RandomLoss
from netlab.medium.medium import Medium
from netlab.medium.pair import DROPPED
from netlab.medium.segments import ChannelSpec, Segment, SegmentKind
from netlab.medium.verdicts import Verdict

SPEC = ChannelSpec("802.11g-20MHz", rate_bps=6e6)
Pairs = dict[tuple[int, int], Impairment]


def medium(count: int, pairs: Pairs | Impairment = PERFECT, *, spec: ChannelSpec = SPEC) -> Medium:
    """``count`` radios on one channel."""
    if isinstance(pairs, Impairment):
        pairs = {(a, b): pairs for a in range(count) for b in range(count) if a != b}
    segment = Segment("air", SegmentKind.RADIO, tuple(range(count)), pairs, channel=spec)
    return Medium([port(index) for index in range(count)], [segment], seed=3)


def told(used: Medium, sender: int, sent: bytes, *, now: float = 0.0) -> list[tuple[int, Verdict]]:
    """(receiver, verdict) of a frame, at once or later."""
    outcomes = used.transmit(sender, sent, now=now)
    for done in used.advance(now=now + 5.0):
        outcomes += done.outcomes
    return [(outcome[1], outcome[3]) for outcome in outcomes]


def test_frames_go_to_their_addressee_or_to_all() -> None:
    used = medium(3)
    assert told(used, 0, frame(0, 2)) == [(2, Verdict.DELIVERED)]
    assert told(used, 0, frame(0), now=10.0) == [(1, Verdict.DELIVERED), (2, Verdict.DELIVERED)]
    assert used.counts[Verdict.DELIVERED] == 3


def test_addresses_that_a_node_has_used_are_known_and_others_cost_no_airtime() -> None:
    used, virtual = medium(3), b"\x02\xaa\xaa\xaa\xaa\xaa"
    to_virtual = virtual + frame(0)[6:]
    assert told(used, 0, to_virtual) == []
    assert used.unaddressed == 1
    assert used.channel_stats["air"].attempts == 0
    told(used, 2, frame(2, 0, source=virtual), now=10.0)
    assert told(used, 0, to_virtual, now=20.0) == [(2, Verdict.DELIVERED)]


def test_what_is_decided_comes_with_its_tag_and_its_times() -> None:
    used = medium(2)
    assert used.next_event() is None
    assert used.transmit(0, frame(0, 1), now=7.0, tag=99) == []
    due_s = used.next_event()
    assert due_s is not None
    (done,) = used.advance(now=due_s + 0.001)
    assert (done.sender, done.tag, done.offered_s, done.attempts) == (0, 99, 7.0, 1)
    (outcome,) = done.outcomes
    assert 7.0 < outcome[0] <= due_s + 0.001
    assert used.signals_dbm(done) == {1: -50}


def test_what_was_decided_when_another_frame_came_is_not_forgotten() -> None:
    used = medium(2)
    used.transmit(0, frame(0, 1), now=0.0)
    used.transmit(0, frame(0, 1), now=1.0)  # the first is long through
    assert [done.offered_s for done in used.advance(now=2.0)] == [0.0, 1.0]


def test_the_pairs_words_act_on_what_arrived() -> None:
    used = medium(2, Impairment(delay_s=0.5, loss=RandomLoss(0.5)))
    outcomes = []
    for number in range(400):
        used.transmit(0, frame(0, 1), now=float(number))
        for done in used.advance(now=number + 0.9):
            assert done.attempts == 1
            outcomes += [(done.offered_s, outcome) for outcome in done.outcomes]
    lost = [outcome for _at, outcome in outcomes if outcome[3] is Verdict.LOST]
    assert len(lost) / 400 == pytest.approx(0.5, abs=0.08)
    assert all(outcome[0] - at_s > 0.5 for at_s, outcome in outcomes if outcome[0] != DROPPED)


def test_pairs_come_into_range_and_go_with_their_words() -> None:
    used = medium(3, {(0, 1): PERFECT, (1, 0): PERFECT})
    assert told(used, 0, frame(0, 2)) == [(2, Verdict.OUT_OF_RANGE)]
    used.set_pairs({(0, 2): Impairment(rssi_dbm=-60.0), (2, 0): PERFECT})
    assert told(used, 0, frame(0, 2), now=10.0) == [(2, Verdict.DELIVERED)]
    used.set_pairs({(0, 2): None})
    assert told(used, 0, frame(0, 2), now=20.0) == [(2, Verdict.OUT_OF_RANGE)]
    used.set_pairs({(0, 2): Impairment(rssi_dbm=-100.0)})  # too weak to be heard
    assert told(used, 0, frame(0, 2), now=30.0) == [(2, Verdict.OUT_OF_RANGE)]


def test_a_matrix_of_strengths_rules_until_the_next_one() -> None:
    used = medium(3)
    matrix = np.full((3, 3), -50.0)
    matrix[0, 1] = -np.inf
    used.set_rssi("air", matrix)
    assert told(used, 0, frame(0, 1)) == [(1, Verdict.OUT_OF_RANGE)]
    assert told(used, 1, frame(1, 0), now=10.0) == [(0, Verdict.DELIVERED)]
    used.set_pairs({(1, 0): None})  # out of range whatever the matrix says
    used.set_rssi("air", np.full((3, 3), -50.0))
    before = used.channel_stats["air"].attempts
    assert told(used, 1, frame(1, 0), now=20.0) == [(0, Verdict.OUT_OF_RANGE)]
    assert used.channel_stats["air"].attempts == before + 7  # the radio knows: nobody answers
    assert told(used, 0, frame(0, 1), now=30.0) == [(1, Verdict.DELIVERED)]


def test_strange_matrices_and_segments_are_refused() -> None:
    used = medium(3)
    with pytest.raises(ValueError, match="matrix"):
        used.set_rssi("air", np.zeros((2, 2)))
    with pytest.raises(ValueError, match="no shared channel"):
        used.set_rssi("water", np.zeros((3, 3)))


def test_an_outage_takes_the_pair_and_gives_it_back() -> None:
    used = medium(2)
    used.set_outage({(0, 1)}, active=True)
    assert told(used, 0, frame(0, 1)) == [(1, Verdict.OUTAGE)]
    used.set_outage({(0, 1)}, active=False)
    assert told(used, 0, frame(0, 1), now=10.0) == [(1, Verdict.DELIVERED)]


def test_a_full_queue_is_told_at_once() -> None:
    used = medium(2, spec=ChannelSpec("802.11g-20MHz", rate_bps=6e6, limit_packets=1))
    assert used.transmit(0, frame(0, 1), now=0.0) == []
    sent = frame(0, 1)
    assert used.transmit(0, sent, now=0.0) == [(DROPPED, 1, sent, Verdict.QUEUE_FULL)]
    assert used.counts[Verdict.QUEUE_FULL] == 1


def test_two_channels_do_not_hear_each_other() -> None:
    def segment(name: str, a: int, b: int) -> Segment:
        return Segment(name, SegmentKind.RADIO, (a, b), {(a, b): PERFECT, (b, a): PERFECT}, channel=SPEC)

    ports = [port(index) for index in range(4)]
    used = Medium(ports, [segment("low", 0, 1), segment("high", 2, 3)], seed=1)
    for sender, receiver in ((0, 1), (2, 3)):
        for _ in range(50):
            used.transmit(sender, frame(sender, receiver), now=0.0)
    assert {outcome[3] for done in used.advance(now=60.0) for outcome in done.outcomes} == {Verdict.DELIVERED}
    assert [stats.attempts for stats in used.channel_stats.values()] == [50, 50]


@pytest.mark.parametrize(
    ("spec", "problem"),
    [
        (ChannelSpec("smoke signals"), "there is no radio 'smoke signals'; there are 802.11g"),
        (ChannelSpec("802.11g-20MHz", rate_bps=7e6), "no rate of 7mbit; its rates are 6mbit"),
    ],
)
def test_unknown_radios_and_rates_are_refused(spec: ChannelSpec, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        medium(2, spec=spec)


def test_a_medium_of_wires_has_nothing_to_wait_for() -> None:
    used = Medium([port(0), port(1)], [Segment("w", SegmentKind.WIRE, (0, 1), {(0, 1): PERFECT})], seed=1)
    assert used.next_event() is None
    assert used.advance(now=1.0) == []
