"""When acknowledgements leave: asked for by the sender, hurried by the receiver where something is missing."""

from __future__ import annotations

import pytest

from udp_mesh.core import wire
from udp_mesh.core.ack_requests import AckRequests
from udp_mesh.core.acks import MAX_ACK_DELAY_S, MAX_ACK_LATER_S, AckTracker


def received(*numbers: int, ack_now: bool = False, ack_later: bool = False) -> AckTracker:
    """Packets 0 to 9, acknowledged; then these, a millisecond apart from second 1 on."""
    tracker = AckTracker()
    tracker.record_run(0, 9, ack_now=True, now=0.0)
    tracker.take(room_bytes=1000, now=0.0)
    for place, number in enumerate(numbers):
        tracker.record(number, is_ack_eliciting=True, ack_now=ack_now, ack_later=ack_later, now=1.0 + 0.001 * place)
    return tracker


def test_every_second_packet_is_acknowledged_at_once_unless_its_sender_can_wait() -> None:
    assert received(10).due_at_s == pytest.approx(1.0 + MAX_ACK_DELAY_S)
    assert received(10, 11).due_at_s == pytest.approx(1.001)
    assert received(10, 11, 12, 13, ack_later=True).due_at_s == pytest.approx(1.0 + MAX_ACK_LATER_S)
    assert received(10, ack_now=True).due_at_s == pytest.approx(1.0)


def test_after_a_gap_the_sender_learns_soon_until_the_loss_is_proven() -> None:
    tracker = received(11, ack_later=True)
    assert tracker.due_at_s == pytest.approx(1.0), "10 is missing"
    tracker.take(room_bytes=1000, now=1.0)
    for number in (12, 13):
        tracker.record(number, is_ack_eliciting=True, ack_now=False, ack_later=True, now=2.0)
    assert tracker.due_at_s == pytest.approx(2.0), "three later ones have arrived"
    tracker.take(room_bytes=1000, now=2.0)
    for number in (15, 16, 17):
        tracker.record(number, is_ack_eliciting=True, ack_now=False, ack_later=True, now=3.0)
    assert tracker.due_at_s == pytest.approx(3.0), "14 is missing"
    tracker.take(room_bytes=1000, now=3.0)
    for number in (18, 19, 20, 21):
        tracker.record(number, is_ack_eliciting=True, ack_now=False, ack_later=True, now=4.0)
    tracker.take(room_bytes=1000, now=4.0)
    for number in (22, 23, 24):
        tracker.record(number, is_ack_eliciting=True, ack_now=False, ack_later=True, now=5.0)
    assert tracker.due_at_s == pytest.approx(5.0 + MAX_ACK_LATER_S), "all is well again"


def flags(count: int, *, stalls: bool = False, repeats: bool = False, spacing_bytes: float = 0.0) -> list[int]:
    requests = AckRequests()
    return [requests.flags(1000, stalls=stalls, repeats=repeats, spacing_bytes=spacing_bytes) for _ in range(count)]


def test_on_a_path_with_spacing_a_packet_asks_now_and_then_and_the_others_may_wait() -> None:
    now, later = wire.FLAG_ACK_NOW, wire.FLAG_ACK_LATER
    assert flags(6, spacing_bytes=2500.0) == [later, later, now] * 2
    assert flags(4, spacing_bytes=500.0) == [later, now] * 2, "not every single one"
    assert flags(2, spacing_bytes=1e6, stalls=True) == [now, now]
    assert flags(2, spacing_bytes=1e6, repeats=True) == [now, now], "what was lost before"


def test_without_spacing_the_receiver_decides() -> None:
    assert flags(3) == [0, 0, 0]
    assert flags(1, repeats=True) == [0]
    assert flags(1, stalls=True) == [wire.FLAG_ACK_NOW]
