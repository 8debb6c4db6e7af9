"""Loss detection and probe timeouts, packet by packet."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core.messages import Message, Transfer
from udp_mesh.core.recovery import Recovery, SentRun
from udp_mesh.core.rtt import RttEstimator
from udp_mesh.core.settings import TopicPolicy
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


def test_only_a_part_of_a_run_is_condemned() -> None:
    recovery = Recovery(rtt=RttEstimator(), now=0.0)
    for number, count in ((0, 6), (6, 1)):
        assert recovery.take_packet_number(count) == number
        recovery.on_sent(number, count=count, size_bytes=100, priority=1, parts=(), now=0.001)
    outcome = recovery.on_ack(ack((6, 6)), now=0.041)
    assert outcome is not None
    assert [(run.packet_number, run.last) for run in outcome.lost] == [(0, 3)]  # each of them with three later ones
    assert (outcome.lost_packets, len(recovery), recovery.in_flight_bytes) == (4, 2, 200)
    assert recovery.next_timer() == pytest.approx(0.001 + 0.040 + 0.010)
    late = recovery.detect_lost(now=0.052)
    assert [(run.packet_number, run.last) for run in late] == [(4, 5)]


def test_one_packet_missing_from_a_run_divides_it() -> None:
    recovery = Recovery(rtt=RttEstimator(), now=0.0)
    recovery.take_packet_number(9)
    recovery.on_sent(0, count=9, size_bytes=100, priority=1, parts=(), now=0.0)
    outcome = recovery.on_ack(ack((7, 8), (5, 5), (0, 3)), now=0.04)
    assert outcome is not None
    assert {n for run in outcome.acked for n in range(run.packet_number, run.last + 1)} == {0, 1, 2, 3, 5, 7, 8}
    assert [(run.packet_number, run.last) for run in outcome.lost] == [(4, 4)]
    assert len(recovery) == 1  # packet 6: fewer than three later ones


class Twins:
    """The same packets twice: in runs, and each on its own. Whatever happens, both must say the same."""

    def __init__(self) -> None:
        self.runs = Recovery(rtt=RttEstimator(), now=0.0)
        self.singles = Recovery(rtt=RttEstimator(), now=0.0)

    def send(self, count: int, *, priority: int, now: float) -> None:
        number = self.runs.take_packet_number(count)
        transfer = Transfer(
            Message(number, "t", bytes(100 * count), TopicPolicy(), datagram_bytes=137, now=now), "b", (0, 0.0, 0)
        )
        self.runs.on_sent(number, count=count, size_bytes=100, priority=priority, parts=((transfer, 0),), now=now)
        for k in range(count):
            assert self.singles.take_packet_number() == number + k
            self.singles.on_sent(number + k, size_bytes=100, priority=priority, parts=((transfer, k),), now=now)

    def compare(self, runs: list[SentRun], singles: list[SentRun]) -> None:
        assert [piece for run in runs for piece in pieces(run)] == [piece for run in singles for piece in pieces(run)]
        assert (len(self.runs), self.runs.in_flight_bytes) == (len(self.singles), self.singles.in_flight_bytes)
        assert self.runs.next_timer() == self.singles.next_timer()
        assert self.runs.lost_packets == self.singles.lost_packets
        assert self.runs.spurious_losses == self.singles.spurious_losses
        assert self.runs.urgent_in_flight(1) == self.singles.urgent_in_flight(1)

    def ack(self, frame: Ack, *, now: float) -> None:
        one, other = self.runs.on_ack(frame, now=now), self.singles.on_ack(frame, now=now)
        assert one is not None
        assert other is not None
        self.compare(one.acked, other.acked)
        self.compare(one.lost, other.lost)
        assert (one.acked_packets, one.acked_bytes) == (other.acked_packets, other.acked_bytes)
        assert (one.rtt_sampled, one.rate_bps, one.lost_packets) == (
            other.rtt_sampled,
            other.rate_bps,
            other.lost_packets,
        )


def pieces(run: SentRun) -> list[SentRun]:
    return [run.cut(number, number) for number in range(run.packet_number, run.last + 1)]


@given(st.data())
def test_runs_mean_what_their_packets_mean(data: st.DataObject) -> None:
    twins, now = Twins(), 0.0
    for _ in range(data.draw(st.integers(1, 15), label="steps")):
        now += data.draw(st.sampled_from([0.0, 0.001, 0.02, 0.2]), label="pause")
        sent = twins.runs.next_packet_number
        action = data.draw(st.sampled_from(["send", "ack", "ack", "time", "probe", "abandon"]), label="action")
        if action == "send" or not sent:
            twins.send(data.draw(st.integers(1, 9)), priority=data.draw(st.integers(0, 2)), now=now)
        elif action == "ack":
            numbers = sorted(data.draw(st.sets(st.integers(0, sent - 1), min_size=1, max_size=6)))
            edges = [(first, last) for first, last in zip(numbers, [*numbers[1:], numbers[-1]], strict=True)]
            ranges = [(a, max(a, b - 2) if (a, b) != edges[-1] else b) for a, b in edges]
            twins.ack(Ack(tuple(reversed(ranges)), received_us=0, delay_us=0), now=now)
        elif action == "time":
            twins.compare(twins.runs.detect_lost(now=now), twins.singles.detect_lost(now=now))
        elif action == "probe" and len(twins.runs):
            one, other = (recovery.on_probe_timeout(now=now) for recovery in (twins.runs, twins.singles))
            twins.compare([one], [other])
        elif action == "abandon":
            twins.compare(twins.runs.abandon(), twins.singles.abandon())
