"""What a subscriber learns of losses, delays, repetitions, restarts and partial data; two stations, no network."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rose.core.addressing import ServiceId
from rose.core.reception import PENDING_MAX, Reception, Sample
from rose.core.station import Published, Station
from rose.core.wire import Fault
from tests.rose.messages import Note, Pose, Scan

LASER, MAP = ServiceId.parse("10.0.0.1/0.1"), ServiceId.parse("10.0.0.2/0.2")
S = 1_000_000_000


class Pair:
    """A publisher and a subscriber whose clocks are set by hand."""

    def __init__(self, cls: type = Scan) -> None:
        self.laser = Station(LASER, epoch_ns=S)
        self.map = Station(MAP, epoch_ns=S)
        self.reception: Reception = self.map.subscribe(LASER, cls)

    def take(self, *datagrams: bytes, now: float = 10.0) -> list[Sample]:
        samples = []
        for datagram in datagrams:
            got = self.map.receive(datagram, now=now, wall_ns=round(now * S))
            samples += got.samples if isinstance(got, Published) else []
        return samples


def poses(pair: Pair, count: int, *, at_s: float = 10.0) -> list[bytes]:
    return [pair.laser.publish(Pose(float(n), 0.0), wall_ns=round(at_s * S))[0] for n in range(count)]


def test_age_and_delay_variation() -> None:
    pair = Pair(Pose)
    first, second = poses(pair, 2, at_s=10.0)
    (sample,) = pair.take(first, now=10.25)
    assert (sample.age_s, sample.delay_variation_s) == (pytest.approx(0.25), 0.0)
    (sample,) = pair.take(second, now=10.4)
    assert (sample.age_s, sample.delay_variation_s) == (pytest.approx(0.4), pytest.approx(0.15))
    assert pair.reception.age_s(now=11.0) == pytest.approx(0.6)


def test_a_gap_is_told_and_closed_by_what_comes_late() -> None:
    pair = Pair(Pose)
    sent = poses(pair, 5)
    assert [s.lost_before for s in pair.take(sent[0], sent[1], sent[4])] == [0, 0, 2]
    assert pair.reception.counters.lost == 2
    (late,) = pair.take(sent[2])
    assert (late.is_late, late.sequence) == (True, 2)
    assert pair.reception.counters.lost == 1


def test_what_was_published_before_we_came_is_not_lost() -> None:
    pair = Pair(Pose)
    sent = poses(pair, 50)
    (sample,) = pair.take(sent[49])
    assert (sample.lost_before, pair.reception.counters.lost) == (0, 0)


def test_duplicates_are_dropped_and_counted() -> None:
    pair = Pair(Pose)
    (sent,) = poses(pair, 1)
    assert len(pair.take(sent, sent, sent)) == 1
    assert pair.reception.counters.faults == {Fault.DUPLICATE: 2}


def test_a_restart_of_the_sender_is_told_and_its_old_datagrams_are_stale() -> None:
    pair = Pair(Pose)
    old = poses(pair, 3)
    pair.take(*old[:2])
    pair.laser = Station(LASER, epoch_ns=2 * S)
    (sample,) = pair.take(*poses(pair, 1))
    assert (sample.is_restart, sample.sequence, sample.lost_before) == (True, 0, 0)
    assert pair.take(old[2]) == []
    assert pair.reception.counters.faults == {Fault.STALE: 1}
    assert pair.reception.counters.restarts == 1


def test_partial_scans_come_out_when_their_time_is_over() -> None:
    pair = Pair()
    parts = pair.laser.publish(Scan(1.0, [1.0] * 500), wall_ns=10 * S)
    assert len(parts) == 4
    assert pair.take(*parts[:-1]) == []
    assert pair.map.next_due() == pytest.approx(10.1)
    (published,) = pair.map.due(now=10.1, wall_ns=10 * S)
    (sample,) = published.samples
    assert sample.completeness == 447 / 500
    assert sample.missing == ((447, 500),)
    assert pair.reception.counters.partial == 1
    assert pair.take(parts[-1]) == []  # too late: this scan has been given out


def test_a_newer_whole_scan_ends_the_wait_for_an_older_one() -> None:
    pair = Pair()
    first = pair.laser.publish(Scan(1.0, [1.0] * 500), wall_ns=10 * S)
    second = pair.laser.publish(Scan(2.0, [2.0] * 500), wall_ns=10 * S)
    samples = pair.take(*first[1:], *second)
    assert [sample.sequence for sample in samples] == [0, 1]
    assert samples[0].completeness < 1.0 == samples[1].completeness


def test_a_message_in_cuts_that_misses_one_is_counted_incomplete() -> None:
    pair = Pair(Note)
    parts = pair.laser.publish(Note("x" * 4000), wall_ns=10 * S)
    assert pair.take(*parts[1:]) == []
    assert pair.map.due(now=11.0, wall_ns=11 * S) == []
    assert pair.reception.counters.incomplete == 1


def test_another_type_is_counted_and_dropped() -> None:
    pair = Pair(Pose)
    assert pair.take(*pair.laser.publish(Note("hello"), wall_ns=S)) == []
    assert pair.map.faults == {Fault.OTHER_TYPE: 1}


def test_whoever_is_not_subscribed_to_is_not_for_us() -> None:
    pair = Pair(Pose)
    stranger = Station(ServiceId.parse("10.0.0.9/0.1"), epoch_ns=S)
    assert pair.take(*stranger.publish(Pose(0.0, 0.0), wall_ns=S)) == []
    assert pair.map.faults == {Fault.NOT_FOR_US: 1}


def test_waiting_parts_are_bounded() -> None:
    pair = Pair()
    for _ in range(50):
        parts = pair.laser.publish(Scan(1.0, [1.0] * 500), wall_ns=10 * S)
        pair.take(parts[0])
    assert len(pair.reception._pending) <= PENDING_MAX


@given(st.integers(0, 2**32), st.floats(0, 0.5), st.floats(0, 0.5))
def test_whatever_the_network_does_each_message_comes_once_and_whole_or_marked(
    seed: int, loss: float, repeat: float
) -> None:
    rng = random.Random(seed)
    pair = Pair()
    sent = {}
    datagrams: list[bytes] = []
    for number in range(30):
        scan = Scan(float(number), [float(number)] * rng.choice([3, 300, 600]))
        sent[number] = scan
        datagrams += pair.laser.publish(scan, wall_ns=10 * S)
    received = [d for d in datagrams if rng.random() >= loss]
    received += [d for d in received if rng.random() < repeat]
    for place in range(len(received) - 1):  # swaps near each other
        if rng.random() < 0.3:
            received[place], received[place + 1] = received[place + 1], received[place]
    samples = pair.take(*received)
    samples += [s for published in pair.map.due(now=20.0, wall_ns=20 * S) for s in published.samples]
    numbers = [sample.sequence for sample in samples]
    assert len(numbers) == len(set(numbers))
    for sample in samples:
        whole = sent[sample.sequence]
        assert isinstance(sample.message, Scan)
        gaps = {n for first, end in sample.missing for n in range(first, end)}
        assert len(sample.message.ranges_m) == len(whole.ranges_m)
        assert all(
            got == sent[sample.sequence].stamp_s for n, got in enumerate(sample.message.ranges_m) if n not in gaps
        )
        assert (sample.completeness == 1.0) == (not gaps)


@given(st.lists(st.binary(max_size=120).map(lambda tail: b"RS\x01\x01" + tail), max_size=20))
def test_no_datagram_raises(datagrams: list[bytes]) -> None:
    pair = Pair()
    whole = pair.laser.publish(Scan(1.0, [1.0]), wall_ns=S)[0]
    pair.take(*datagrams, *(whole[:60] + datagram for datagram in datagrams))
