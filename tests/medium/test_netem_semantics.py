"""Order, queue limit, rate, reorder, duplicate, corrupt and live change, as sch_netem has them."""

from __future__ import annotations

from collections import Counter

import pytest
from media import frame, lost, stream, wire

from netlab.medium.impairments import GilbertElliottLoss, Impairment, PeriodicLoss, RandomLoss
from netlab.medium.pair import DROPPED
from netlab.medium.verdicts import Verdict


def verdicts(outcomes: list[tuple[float, int, bytes, Verdict]]) -> Counter[Verdict]:
    return Counter(outcome[3] for outcome in outcomes)


@pytest.mark.parametrize("jitter_s", [0.0, 1e-9], ids=["plain", "any"])
def test_the_limit_counts_delayed_frames(jitter_s: float) -> None:
    """100 ms of delay at 1000 frames/s keep 100 frames waiting; only 20 may."""
    outcomes = stream(wire(Impairment(delay_s=0.1, jitter_s=jitter_s, limit_packets=20)), 250)
    assert [o[3] for o in outcomes[:21]] == [Verdict.DELIVERED] * 20 + [Verdict.QUEUE_FULL]
    assert verdicts(outcomes)[Verdict.DELIVERED] == pytest.approx(60, abs=3)  # 20 per 100 ms, 250 ms


def test_the_limit_in_bytes() -> None:
    outcomes = stream(wire(Impairment(delay_s=0.1, limit_packets=None, limit_bytes=1000)), 15, size=300)
    assert [o[3] for o in outcomes] == [Verdict.DELIVERED] * 3 + [Verdict.QUEUE_FULL] * 12


def test_a_limit_of_zero_takes_nothing() -> None:
    assert set(verdicts(stream(wire(Impairment(limit_packets=0)), 3))) == {Verdict.QUEUE_FULL}


def test_loss_comes_before_the_queue() -> None:
    """A frame that the loss model takes needs no room."""
    impairment = Impairment(delay_s=1.0, limit_packets=1, loss=PeriodicLoss(every=2))
    outcomes = stream(wire(impairment), 4)
    assert [o[3] for o in outcomes] == [Verdict.LOST, Verdict.DELIVERED, Verdict.LOST, Verdict.QUEUE_FULL]


def test_rate_spaces_frames_by_their_length() -> None:
    """1250 bytes at 10 Mbit/s take 1 ms, one after the other."""
    outcomes = stream(wire(Impairment(rate_bps=10e6)), 10, every_s=0.0, size=1250)
    assert [o[0] for o in outcomes] == pytest.approx([0.001 * k for k in range(1, 11)])


def test_rate_holds_over_a_long_overload() -> None:
    outcomes = stream(wire(Impairment(rate_bps=8e6, limit_packets=50)), 5000, every_s=0.0005, size=1000)
    through = [o for o in outcomes if o[0] != DROPPED]
    span = through[-1][0] - through[0][0]
    assert (len(through) - 1) * 8000 / span == pytest.approx(8e6, rel=0.001)


def test_waiting_for_the_rate_counts_towards_the_delay() -> None:
    """The second frame waits 10 ms for the first; of its 15 ms of delay only 5 are left after that."""
    impairment = Impairment(delay_s=0.015, rate_bps=1e6)
    first, second, third = [o[0] for o in stream(wire(impairment), 3, every_s=0.0, size=1250)]
    assert first == pytest.approx(0.015 + 0.010)
    assert second == pytest.approx(first + 0.010)  # 25 ms of waiting exceed the delay: none is left
    assert third == pytest.approx(second + 0.010)


def test_delay_is_credited_partly() -> None:
    impairment = Impairment(delay_s=0.015, rate_bps=1e6)
    medium = wire(impairment)
    (first,) = medium.transmit(0, frame(0, 1, 1250), now=0.0)
    (second,) = medium.transmit(0, frame(0, 1, 1250), now=0.020)
    assert first[0] == pytest.approx(0.025)
    # Waits 5 ms for the first, 10 ms of delay remain, then 10 ms on the line.
    assert second[0] == pytest.approx(0.025 + 0.010 + 0.010)


def test_reorder_sends_every_gap_th_frame_at_once() -> None:
    outcomes = stream(wire(Impairment(delay_s=0.010, reorder_ratio=1.0, reorder_gap=5)), 15)
    assert [k for k, o in enumerate(outcomes) if o[3] is Verdict.REORDERED] == [4, 9, 14]
    assert all(o[0] == k * 0.001 for k, o in enumerate(outcomes) if o[3] is Verdict.REORDERED)


def test_reorder_ratio() -> None:
    outcomes = stream(wire(Impairment(delay_s=0.010, reorder_ratio=0.25)), 8000)
    assert verdicts(outcomes)[Verdict.REORDERED] / 8000 == pytest.approx(0.25, abs=0.016)


def test_duplicates_arrive_twice_and_a_copy_is_not_copied_again() -> None:
    outcomes = stream(wire(Impairment(duplicate_ratio=1.0)), 10)
    assert verdicts(outcomes) == {Verdict.DUPLICATED: 10, Verdict.DELIVERED: 10}


def test_a_duplicated_frame_that_is_lost_arrives_once() -> None:
    """netem counts: one, plus one copy, minus one loss."""
    impairment = Impairment(duplicate_ratio=1.0, loss=PeriodicLoss(every=2))
    outcomes = stream(wire(impairment), 4)
    assert verdicts(outcomes) == {Verdict.DELIVERED: 4}


def test_duplicate_ratio() -> None:
    outcomes = stream(wire(Impairment(duplicate_ratio=0.1)), 8000)
    assert verdicts(outcomes)[Verdict.DUPLICATED] / 8000 == pytest.approx(0.1, abs=0.012)


def test_corruption_flips_one_bit_anywhere() -> None:
    outcomes = stream(wire(Impairment(corrupt_ratio=1.0)), 3000)
    sent = int.from_bytes(frame(0, 1), "big")
    flipped = [int.from_bytes(o[2], "big") ^ sent for o in outcomes]
    assert all(bits.bit_count() == 1 for bits in flipped)
    assert len(set(flipped)) > 700  # of 800 bits
    assert verdicts(outcomes) == {Verdict.CORRUPTED: 3000}


def test_outage_is_silent_and_frames_under_way_still_arrive() -> None:
    medium = wire(Impairment(delay_s=0.5))
    (under_way,) = medium.transmit(0, frame(0, 1), now=0.0)
    medium.set_outage([(0, 1)], active=True)
    (cut,) = medium.transmit(0, frame(0, 1), now=0.1)
    medium.set_pairs({(0, 1): Impairment(delay_s=0.1)})
    (still_cut,) = medium.transmit(0, frame(0, 1), now=0.2)
    medium.set_outage([(0, 1)], active=False)
    (again,) = medium.transmit(0, frame(0, 1), now=0.3)
    assert under_way[0] == 0.5
    assert (cut[3], still_cut[3]) == (Verdict.OUTAGE, Verdict.OUTAGE)
    assert again[0] == pytest.approx(0.4)


def test_a_change_keeps_the_queue() -> None:
    medium = wire(Impairment(delay_s=1.0, limit_packets=10))
    stream(medium, 10)
    medium.set_pairs({(0, 1): Impairment(delay_s=0.001, limit_packets=10)})
    assert verdicts(stream(medium, 3, start=0.5)) == {Verdict.QUEUE_FULL: 3}
    assert verdicts(stream(medium, 1, start=1.5)) == {Verdict.DELIVERED: 1}


def test_a_change_keeps_the_random_stream() -> None:
    """The same change at every tick must not replay the same draws."""
    impairment = Impairment(loss=RandomLoss(0.5))
    steady, changed = wire(impairment), wire(impairment)
    expected = lost(stream(steady, 400))
    got: list[bool] = []
    for _ in range(40):
        changed.set_pairs({(0, 1): impairment})
        got += lost(stream(changed, 10))
    assert got == expected


def test_from_any_model_to_any_other_and_back() -> None:
    medium = wire(Impairment(loss=GilbertElliottLoss(0.5, 0.5)))
    stream(medium, 10)
    medium.set_pairs({(0, 1): None})
    assert verdicts(stream(medium, 5)) == {Verdict.OUT_OF_RANGE: 5}
    medium.set_pairs({(0, 1): Impairment(loss=RandomLoss(1.0))})
    assert verdicts(stream(medium, 5)) == {Verdict.LOST: 5}
