"""What waits for a member: the most urgent first, next hops in turn, bounded; and what is urgent."""

from __future__ import annotations

import pytest

from wnet.core import wire
from wnet.core.budget import Budget
from wnet.core.hop_timer import HopTimer
from wnet.core.link import Link
from wnet.core.queues import MemberQueue
from wnet.core.seen import GENERATION, Seen
from wnet.core.transmissions import Entry, Packet, Transmission
from wnet.core.urgency import urgency_of, urgency_of_dscp

TARGET_S = 0.02
OWN, A, B = (bytes((2, 0, 0, 0, 0, n)) for n in (1, 2, 3))


def link(peer: bytes) -> Link:
    made = Link(0, OWN, peer, peer, rto_min_s=0.01)
    made.is_usable = True
    return made


def frame(to: Link, urgency: int, number: int = 0) -> Transmission:
    packet = Packet(wire.UNICAST, wire.tail_of(1, number, to.peer_mac + OWN + b"\x08\x00"), 9, urgency, None)
    return Transmission(packet, 0, [Entry(to, (to.peer_mac,))], 3)


def test_the_most_urgent_leaves_first_and_next_hops_take_turns() -> None:
    queue, a, b = MemberQueue(10, TARGET_S), link(A), link(B)
    waiting = [frame(a, 6, 1), frame(a, 6, 2), frame(b, 6, 3), frame(a, 1, 4)]
    for transmission in waiting:
        queue.push(transmission)
    order = [queue.pop() for _ in range(4)]
    assert order == [waiting[3], waiting[0], waiting[2], waiting[1]]
    assert queue.pop() is None


def test_a_next_hop_with_much_under_way_does_not_hold_up_others() -> None:
    queue, a, b = MemberQueue(10, TARGET_S), link(A), link(B)
    a.timer.window = 1.0
    blocked, free = frame(a, 1), frame(b, 6)
    a.pending[0] = (blocked, blocked.entries[0], 0.0)
    queue.push(blocked)
    queue.push(free)
    assert queue.pop() is free
    assert queue.pop() is None
    a.pending.clear()
    assert queue.pop() is blocked


def test_a_full_class_loses_the_oldest_of_its_longest_row_and_no_other_class_does() -> None:
    queue, a, b = MemberQueue(3, TARGET_S), link(A), link(B)
    first = frame(a, 6, 1)
    assert [queue.push(t) for t in (first, frame(a, 6, 2), frame(b, 6, 3), frame(a, 1, 4))] == [None] * 4
    assert queue.push(frame(b, 6, 5)) is first
    assert len(queue) == 4


def test_a_row_that_stands_loses_frames_and_the_others_do_not() -> None:
    queue, a, b = MemberQueue(1000, TARGET_S), link(A), link(B)
    condemned: list[Transmission] = []
    for turn in range(400):  # two for a, one for b; two leave
        now = turn * 0.01
        for to in (a, a, b):
            transmission = frame(to, 6)
            transmission.queued_at = now
            queue.push(transmission)
        for _ in range(2):
            taken = queue.pop()
            assert taken is not None
            if queue.stands(taken, now=now):
                condemned.append(taken)
    assert len(condemned) > 50, "frames for b, on time, say nothing of those for a"
    assert {transmission.entries[0].link for transmission in condemned} == {a}


def test_what_is_sent_again_is_not_judged_by_how_long_the_first_time_took() -> None:
    queue, a = MemberQueue(10, TARGET_S), link(A)
    again = frame(a, 6)
    again.attempts = 1
    queue.push(frame(a, 6))
    assert not any(queue.stands(again, now=turn / 100) for turn in range(100))


@pytest.mark.parametrize(
    ("dscp", "urgency"), [(46, 2), (48, 1), (56, 1), (34, 3), (26, 4), (18, 5), (0, 6), (10, 6), (8, 7), (1, 7)]
)
def test_urgency_by_dscp(dscp: int, urgency: int) -> None:
    assert urgency_of_dscp(dscp) == urgency
    ethernet = A + B
    assert urgency_of(ethernet + b"\x08\x00\x45" + bytes((dscp << 2,))) == urgency
    ipv6 = (6 << 28 | dscp << 22).to_bytes(4, "big")
    assert urgency_of(ethernet + b"\x86\xdd" + ipv6) == urgency


def test_arp_is_no_bulk_and_a_cut_off_packet_no_mistake() -> None:
    assert urgency_of(A + B + b"\x08\x06") == 3
    assert urgency_of(A + B + b"\x08\x00") == 3


def test_seen_is_bounded_and_remembers_at_least_a_generation() -> None:
    seen = Seen()
    keys = [n.to_bytes(4, "big") for n in range(3 * GENERATION)]
    assert all(seen.add(key) for key in keys)
    assert len(seen) <= 2 * GENERATION
    assert not any(seen.add(key) for key in keys[-GENERATION:])


def test_the_round_trip_decides_how_long_to_wait() -> None:
    timer = HopTimer(0.01)
    assert timer.rto_s == 0.05
    for n in range(50):
        timer.sample(0.002, in_flight=1, now=n * 0.1)
    assert timer.rto_s == 0.01
    for n in range(50):
        timer.sample(0.04, in_flight=1, now=5 + n * 0.1)
    assert 0.04 <= timer.rto_s < 0.08


def test_the_window_follows_the_queue_that_is_not_ours() -> None:
    timer = HopTimer(0.01)
    timer.sample(0.002, in_flight=1, now=0.0)
    for n in range(400):
        timer.sample(0.004, in_flight=int(timer.window), now=0.01 * n)
    wide = timer.window
    assert wide > 100
    for n in range(400):
        timer.sample(0.05, in_flight=int(timer.window), now=4.0 + 0.05 * n)
        if n == 100:
            assert timer.window < 8


def test_a_budget_bounds_what_is_spent_in_the_long_run() -> None:
    budget, now, spent_s = Budget(0.02, now=0.0), 0.0, 0.0
    budget.divide(20)
    while now < 1000.0:
        if budget.wait_s(0.0005, now=now) == 0.0:
            budget.spend(0.0005, now=now)
            spent_s += 0.0005
        now += 0.01
    assert 0.9 <= spent_s / (0.001 * (1000.0 + 15.0)) <= 1.01
