"""What less urgent messages get, and what neighbours leave each other: the floor and coordination."""

from __future__ import annotations

from typing import Any

import pytest


def flood(net: Any, sender: str, topic: str, to: str, *, priority: int, duration_s: float) -> None:
    """Keep something waiting at a node."""

    def refill() -> None:
        while net.cores[sender].queue_depths().get(topic, 0) < 8:
            net.publish(sender, topic, bytes(20_000), to, priority=priority)

    net.every(0.01, refill, until_s=net.now + duration_s)


def received_bytes(net: Any, name: str, topic: str) -> int:
    return sum(len(message.payload) for message in net.delivered(name, topic))


@pytest.mark.parametrize("floor", [0.0, 0.2])
def test_the_floor_is_what_less_urgent_messages_get(make_net: Any, floor: float) -> None:
    net = make_net(seed=7)
    net.add("a", floor_ratio=floor)
    net.add("b")
    net.meet()
    net.link("a", "b", rate_bps=10e6, limit_packets=50)
    for topic, priority in (("map", 5), ("video", 9)):
        flood(net, "a", topic, "b", priority=priority, duration_s=4.0)
    net.run(4.0)
    video, everything = received_bytes(net, "b", "video"), received_bytes(net, "b", "map")
    assert video / (video + everything) == pytest.approx(floor, abs=0.03)


def test_without_competition_the_floor_costs_nothing(make_net: Any) -> None:
    net = make_net(seed=7)
    net.add("a", floor_ratio=0.3)
    net.add("b")
    net.meet()
    net.link("a", "b", rate_bps=10e6, limit_packets=50)
    flood(net, "a", "map", "b", priority=5, duration_s=3.0)
    net.run(3.0)
    assert received_bytes(net, "b", "map") * 8 / 3.0 > 0.9 * 10e6 * 1363 / 1442


@pytest.mark.parametrize("coordinate", [False, True])
def test_video_of_one_robot_yields_to_the_map_of_another(make_net: Any, coordinate: bool) -> None:
    net = make_net(seed=7)
    for name in ("base", "r1", "r2"):
        net.add(name, coordinate=coordinate)
    net.meet()
    net.links["r1", "base"].rate_bps = net.links["r2", "base"].rate_bps = 5e6
    flood(net, "r1", "video", "base", priority=9, duration_s=9.0)
    net.run(2.0)
    alone = received_bytes(net, "base", "video")
    flood(net, "r2", "map", "base", priority=4, duration_s=3.0)
    net.run(3.0)
    during = received_bytes(net, "base", "video") - alone
    net.run(1.0)
    before = received_bytes(net, "base", "video")
    net.run(2.0)
    after = received_bytes(net, "base", "video") - before
    if coordinate:
        assert 0.02 * 5e6 / 8 * 3 < during < 0.25 * 5e6 / 8 * 3
    else:
        assert during > 0.8 * 5e6 / 8 * 3
    assert after > 0.75 * 5e6 / 8 * 2  # and it takes up again at once
    assert received_bytes(net, "base", "map") > 0.8 * 5e6 / 8 * 3


def test_equally_urgent_nodes_do_not_yield_and_urgent_messages_pass(make_net: Any) -> None:
    net = make_net(seed=7)
    for name in ("base", "r1", "r2"):
        net.add(name, coordinate=True)
    net.meet()
    net.links["r1", "base"].rate_bps = net.links["r2", "base"].rate_bps = 5e6
    flood(net, "r1", "video", "base", priority=4, duration_s=3.0)
    flood(net, "r2", "map", "base", priority=4, duration_s=3.0)
    net.run(1.0)
    net.publish("r1", "alarm", b"x", "base", priority=0)
    sent_s = net.now
    net.run(2.0)
    assert received_bytes(net, "base", "video") > 0.8 * 5e6 / 8 * 3
    (alarm,) = net.delivered("base", "alarm")
    assert alarm.now - sent_s < 0.02


def test_an_idle_node_announces_nothing(make_net: Any) -> None:
    net = make_net(seed=7)
    for name in ("a", "b"):
        net.add(name, coordinate=True)
    net.meet()
    net.keep_datagrams = True
    net.every(0.1, lambda: net.publish("a", "t", bytes(100), "b"), until_s=net.now + 2)
    net.run(2.0)
    assert not [packet for _at, packet in net.packets("a") if packet.backlogs]


def test_equally_urgent_backlogs_divide_the_time_of_a_known_channel(make_net: Any) -> None:
    """Two nodes' videos get half of the half that is divided each; urgent messages are not held back, only charged."""
    net = make_net(seed=7)
    for name in ("base", "r1", "r2"):
        net.add(name, coordinate=True, shared_bps=6e6)
    net.meet()
    net.links["r1", "base"].rate_bps = net.links["r2", "base"].rate_bps = 6e6
    for sender in ("r1", "r2"):
        flood(net, sender, "video", "base", priority=9, duration_s=4.0)
    net.run(1.0)  # they have heard of each other
    before = received_bytes(net, "base", "video")
    sent_s: list[float] = []

    def alarm() -> None:
        sent_s.append(net.now)
        net.publish("r1", "alarm", bytes(100), "base", priority=1)

    net.every(0.1, alarm, until_s=net.now + 2.0)
    net.run(2.0)
    video_bps = (received_bytes(net, "base", "video") - before) * 8 / 2.0
    # A full packet of 1363 bytes of payload takes 2.2 ms with all that belongs to it, so 0.5 of the time is 2.5 Mbit/s.
    assert video_bps == pytest.approx(2.5e6, rel=0.08)
    alarms = net.delivered("base", "alarm")
    assert max(message.now - at_s for message, at_s in zip(alarms, sent_s, strict=False)) < 0.02


def test_who_is_alone_on_a_known_channel_takes_all_of_it(make_net: Any) -> None:
    net = make_net(seed=7)
    for name in ("base", "r1"):
        net.add(name, coordinate=True, shared_bps=6e6)
    net.meet()
    net.link("r1", "base", rate_bps=5e6, limit_packets=50)
    flood(net, "r1", "video", "base", priority=9, duration_s=3.0)
    net.run(3.0)
    assert received_bytes(net, "base", "video") * 8 / 3.0 > 0.85 * 5e6 * 1363 / 1442


def test_fragments_do_not_shrink_because_the_share_is_small(make_net: Any) -> None:
    """On a link of 300 kbit/s fragments shrink to 8 ms each; where it is a part of a faster channel they need not."""
    sizes = {}
    for shared_bps in (0.0, 6e6):
        net = make_net(seed=7)
        for name in ("base", "r1"):
            net.add(name, shared_bps=shared_bps)
        net.meet()
        net.link("r1", "base", rate_bps=300e3, limit_packets=50)
        flood(net, "r1", "video", "base", priority=9, duration_s=12.0)
        net.run(11.0)  # what was published before keeps its fragments
        net.keep_datagrams = True
        net.run(1.0)
        sizes[shared_bps] = max(len(datagram.data) for _at, datagram in net.sent["r1"][-10:])
    assert sizes[0.0] < 500
    assert sizes[6e6] > 1300


def test_a_pace_from_a_round_trip_that_was_no_rule_does_not_hold_urgent_messages(make_net: Any) -> None:
    """The first answer took a second (ARP), the pace that came of it is slow, and nothing is in flight any more."""
    net = make_net(seed=7)
    net.add("a")
    net.add("b")
    net.link("a", "b", delay_s=0.5)
    net.meet()
    net.run(2.0)  # the greeting's answer has come
    net.link("a", "b", delay_s=0.001)
    net.publish("a", "bulk", bytes(20_000), "b", priority=9)
    net.run(0.01)
    started_s = net.now
    net.publish("a", "alarm", bytes(100), "b", priority=1)
    net.run(1.0)
    (alarm,) = net.delivered("b", "alarm")
    assert alarm.now - started_s < 0.01
