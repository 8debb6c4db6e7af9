"""Loss detection and probe timeouts, packet by packet."""

from __future__ import annotations

import pytest

from udp_mesh.core.recovery import Recovery
from udp_mesh.core.rtt import RttEstimator
from udp_mesh.core.wire import Ack


def sender(packets: int, *, interval_s: float = 0.001) -> Recovery:
    recovery = Recovery(rtt=RttEstimator(), now=0.0)
    for number in range(packets):
        assert recovery.take_packet_number() == number
        recovery.on_sent(number, size_bytes=100, priority=number % 3, parts=(), now=number * interval_s)
    return recovery


def ack(*ranges: tuple[int, int]) -> Ack:
    return Ack(ranges, received_us=0, delay_us=0)


def test_three_later_packets_condemn_an_earlier_one_at_once() -> None:
    recovery = sender(5)
    outcome = recovery.on_ack(ack((1, 4)), now=0.044)
    assert outcome is not None
    assert [packet.packet_number for packet in outcome.acked] == [1, 2, 3, 4]
    assert [packet.packet_number for packet in outcome.lost] == [0]
    assert (len(recovery), recovery.in_flight_bytes, recovery.lost_packets) == (0, 0, 1)


def test_fewer_later_packets_condemn_it_after_a_quarter_of_the_round_trip() -> None:
    recovery = sender(2)
    outcome = recovery.on_ack(ack((1, 1)), now=0.041)  # a round trip of 40 ms
    assert outcome is not None
    assert outcome.lost == []
    assert recovery.next_timer() == pytest.approx(0.0 + 0.040 + 0.010)
    assert [packet.packet_number for packet in recovery.detect_lost(now=0.0501)] == [0]


def test_a_late_acknowledgement_widens_the_reordering_window() -> None:
    recovery = sender(5)
    recovery.on_ack(ack((1, 4)), now=0.044)
    recovery.on_ack(ack((0, 4)), now=0.046)
    assert recovery.spurious_losses == 1
    for number in range(5, 10):
        recovery.take_packet_number()
        recovery.on_sent(number, size_bytes=100, priority=1, parts=(), now=0.1)
    outcome = recovery.on_ack(ack((6, 9), (0, 4)), now=0.140)
    assert outcome is not None
    assert outcome.lost == []  # as many later packets as before, but now the order is known to change


def test_acknowledgements_of_packets_never_sent_are_refused() -> None:
    recovery = sender(3)
    assert recovery.on_ack(ack((0, 3)), now=0.1) is None
    assert len(recovery) == 3


def test_a_repeated_acknowledgement_changes_nothing() -> None:
    recovery = sender(3)
    recovery.on_ack(ack((0, 2)), now=0.04)
    outcome = recovery.on_ack(ack((0, 2)), now=0.05)
    assert outcome is not None
    assert (outcome.acked, outcome.lost, outcome.rtt_sampled) == ([], [], False)


def test_a_probe_repeats_the_most_urgent_packet_and_waits_again() -> None:
    recovery = sender(6)
    first_s = recovery.probe_at_s
    packet = recovery.on_probe_timeout(now=first_s)
    assert packet.packet_number == 0
    assert len(recovery) == 6
    assert recovery.expirations == 1
    assert recovery.probe_at_s - first_s == pytest.approx(recovery.rtt.probe_timeout_s(expirations=1))
    recovery.on_ack(ack((0, 0)), now=first_s + 0.01)
    assert recovery.expirations == 0


def test_urgency_in_flight_is_counted_by_priority() -> None:
    recovery = sender(7)  # priorities 0 1 2 0 1 2 0
    assert [recovery.urgent_in_flight(priority) for priority in (0, 1, 2)] == [3, 5, 7]
    recovery.on_ack(ack((0, 1)), now=0.05)
    assert [recovery.urgent_in_flight(priority) for priority in (0, 1, 2)] == [2, 3, 5]
    assert [packet.packet_number for packet in recovery.abandon()] == [2, 3, 4, 5, 6]
    assert recovery.urgent_in_flight(2) == 0


@pytest.mark.parametrize(("rtt_s", "cap_s"), [(0.02, 0.1), (0.06, 0.1)])
def test_probe_timeouts_stay_at_a_tenth_of_a_second_on_fast_paths(rtt_s: float, cap_s: float) -> None:
    rtt = RttEstimator()
    for _ in range(50):
        rtt.update(rtt_s, ack_delay_s=0.0)
    timeouts = [rtt.probe_timeout_s(expirations=count) for count in range(8)]
    assert timeouts == sorted(timeouts)
    assert rtt_s < timeouts[0] < cap_s
    assert timeouts[-1] == cap_s


def test_probe_timeouts_on_slow_paths_are_never_below_what_the_path_takes() -> None:
    rtt = RttEstimator()
    for sample_s in (2.0, 3.0, 2.0, 3.0):
        rtt.update(sample_s, ack_delay_s=0.0)
    base_s = rtt.srtt_s + 4 * rtt.rttvar_s
    assert all(rtt.probe_timeout_s(expirations=count) == base_s for count in range(5))
