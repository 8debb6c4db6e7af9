"""Redundancy and repeated retransmissions: how often fragments leave, when, and that nobody receives them twice."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from udp_mesh.core import events
from udp_mesh.core.copies import SPREAD_S
from udp_mesh.core.settings import Reliability


def pair(make_net: Any, seed: int = 1, **link: float) -> Any:
    net = make_net(seed=seed, **link)
    net.add("a")
    net.add("b")
    net.meet()
    net.run(1.0)
    net.keep_datagrams = True
    return net


def times_of(net: Any, message_id: int) -> list[float]:
    """When each packet with a fragment of this message left."""
    return [at for at, packet in net.packets("a") if any(f.message_id == message_id for f in packet.fragments)]


@pytest.mark.parametrize("redundancy", [1, 2, 3])
def test_a_redundant_message_leaves_so_often_and_arrives_once(make_net: Any, redundancy: int) -> None:
    net = pair(make_net, delay_s=0.05)
    number = net.publish("a", "alarm", b"x" * 100, "b", redundancy=redundancy)
    net.run(0.5)
    times = times_of(net, number)
    assert [later - sooner for sooner, later in pairwise(times)] == pytest.approx([SPREAD_S] * (redundancy - 1))
    assert len(net.delivered("b")) == 1
    assert not net.of("a", events.FragmentRetransmitted)


def test_a_copy_is_saved_when_the_arrival_is_known(make_net: Any) -> None:
    net = pair(make_net, delay_s=SPREAD_S / 4)
    number = net.publish("a", "alarm", b"x", "b", redundancy=4)
    net.run(0.5)
    assert len(times_of(net, number)) == 1


def test_redundancy_bridges_a_loss_without_a_round_trip(make_net: Any) -> None:
    net = pair(make_net, delay_s=0.05)
    net.one_way("a", "b", is_cut=True)
    began_s = net.now
    net.publish("a", "alarm", b"x", "b", redundancy=2)
    net.run(SPREAD_S / 2)
    net.one_way("a", "b", is_cut=False)
    net.run(0.5)
    (message,) = net.delivered("b")
    assert message.now - began_s == pytest.approx(0.05 + SPREAD_S)


def test_best_effort_ends_only_when_no_copy_is_left(make_net: Any) -> None:
    net = pair(make_net, delay_s=SPREAD_S / 4)
    net.one_way("a", "b", is_cut=True)
    net.publish("a", "alarm", b"x", "b", redundancy=2, reliability=Reliability.BEST_EFFORT)
    net.run(SPREAD_S / 2)
    net.one_way("a", "b", is_cut=False)
    net.publish("a", "bulk", bytes(20_000), "b")  # its acknowledgements condemn the first packet
    net.run(0.5)
    assert [message.topic for message in net.delivered("b")].count("alarm") == 1
    assert not net.of("a", events.MessageDropped)


def test_redundant_broadcasts_leave_as_often_and_arrive_once(make_net: Any) -> None:
    net = pair(make_net, delay_s=0.05)
    number = net.publish("a", "alarm", b"x", "all", redundancy=3)
    net.run(0.5)
    assert len(times_of(net, number)) == 3
    assert len(net.delivered("b")) == 1
    assert net.cores["a"].queue_depths() == {}


def test_retransmissions_of_small_messages_leave_twice_those_of_large_ones_once(make_net: Any) -> None:
    net = pair(make_net, delay_s=0.05)
    for size, copies in ((100, 3), (50_000, 2)):
        net.one_way("a", "b", is_cut=True)
        number = net.publish("a", "t", bytes(size), "b")
        net.run(0.001)
        net.one_way("a", "b", is_cut=False)
        net.publish("a", "later", bytes(20_000), "b", priority=9)
        net.run(2.0)
        packets = [p for _at, p in net.packets("a") if any(f.message_id == number for f in p.fragments)]
        first = [f for p in packets for f in p.fragments if f.message_id == number and f.fragment_index == 0]
        assert len(first) == copies
    assert len(net.delivered("b", "t")) == 2


def test_a_small_message_survives_the_loss_of_its_retransmission_sooner(make_net: Any) -> None:
    """15 % loss each way: without a second try, one message in 40 takes two round trips or more; with it, 1 in 300."""
    outcomes = [late_of(make_net, seed) for seed in range(1, 5)]
    assert sum(late for late, _count in outcomes) <= 0.01 * sum(count for _late, count in outcomes), outcomes


def late_of(make_net: Any, seed: int) -> tuple[int, int]:
    """How many messages of telemetry came later than 1.7 round trips, and how many were sent."""
    net = pair(make_net, seed, delay_s=0.03)
    net.link("a", "b", loss_ratio=0.15, rate_bps=5e6, limit_packets=200)
    published = {}
    began_s = net.now

    def bulk() -> None:
        while net.cores["a"].stats()["queued_bytes"] < 60_000:
            net.publish("a", "bulk", bytes(20_000), "b", priority=9)

    def telemetry() -> None:
        published[net.publish("a", "t", bytes(200), "b", priority=1)] = net.now

    net.every(0.02, bulk, until_s=began_s + 8)
    net.every(0.02, telemetry, until_s=began_s + 8)
    net.run(9.0)
    late = [m for m in net.delivered("b", "t") if m.now - published[m.message_id] > 0.03 + 1.7 * 0.06]
    assert len(net.delivered("b", "t")) == len(published)
    return len(late), len(published)
