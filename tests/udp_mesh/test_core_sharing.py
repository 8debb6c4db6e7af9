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
