"""Per-topic rate limits: the rate holds, nothing else waits for them, and what is newest still wins."""

from __future__ import annotations

from typing import Any

import pytest

from udp_mesh.core.events import MessageHeld, MessageReleased
from udp_mesh.core.settings import Keep, TopicPolicy


def pair(make_net: Any, policy: TopicPolicy, **others: TopicPolicy) -> Any:
    net = make_net(delay_s=0.001)
    net.add("a", topics={"video": policy, **others})
    net.add("b")
    net.meet()
    return net


def test_a_topic_sends_so_many_messages_per_second_and_the_rest_waits(make_net: Any) -> None:
    net = pair(make_net, TopicPolicy(rate_limit_hz=5.0))
    for number in range(12):
        net.publish("a", "video", bytes([number]), "b")
    net.run(0.1)
    assert len(net.delivered("b")) == 1
    net.run(1.0)
    assert len(net.delivered("b")) == 6
    net.run(5.0)
    assert [message.payload[0] for message in net.delivered("b")] == list(range(12))


def test_bits_per_second_count_every_destination(make_net: Any) -> None:
    net = make_net(delay_s=0.001)
    net.add("a", topics={"video": TopicPolicy(rate_limit_bps=160_000.0)})
    net.add("b")
    net.add("c")
    net.meet()
    for _ in range(4):
        net.publish("a", "video", bytes(10_000), "all")  # 160 kbit with both copies
    net.run(2.5)
    assert len(net.delivered("b")) == len(net.delivered("c")) == 3


def test_other_topics_pass_what_is_held(make_net: Any) -> None:
    net = pair(make_net, TopicPolicy(priority=1, rate_limit_hz=0.1))
    net.publish("a", "video", b"first", "b")
    net.publish("a", "video", b"second", "b")
    net.publish("a", "log", b"less urgent", "b", priority=9)
    net.run(0.5)
    assert [message.payload for message in net.delivered("b")] == [b"first", b"less urgent"]


def test_keep_latest_and_lifetimes_thin_out_what_is_held(make_net: Any) -> None:
    net = pair(make_net, TopicPolicy(keep=Keep.LATEST, rate_limit_hz=1.0, lifetime_s=5.0))
    for number in range(10):
        net.publish("a", "video", bytes([number]), "b")
        net.run(0.01)
    net.run(3.0)
    assert [message.payload[0] for message in net.delivered("b")] == [0, 9]
    assert net.cores["a"].queue_depths() == {}
    assert net.cores["a"].stats()["dropped_superseded"] == 8


def test_held_messages_count_against_the_queue(make_net: Any) -> None:
    net = make_net()
    net.add("a", queue_messages=10, topics={"video": TopicPolicy(rate_limit_hz=1.0)})
    net.add("b")
    net.meet()
    for _ in range(20):
        net.publish("a", "video", b"x", "b")
    assert net.cores["a"].queue_depths()["video"] == 10
    assert net.cores["a"].stats()["dropped_queue_full"] == 10


@pytest.mark.parametrize("pause_s", [0.0, 10.0])
def test_a_pause_earns_no_burst(make_net: Any, pause_s: float) -> None:
    net = pair(make_net, TopicPolicy(rate_limit_hz=4.0))
    net.publish("a", "video", b"x", "b")
    net.run(max(pause_s, 0.26))
    for _ in range(8):
        net.publish("a", "video", b"x", "b")
    net.run(1.05)
    assert len(net.delivered("b")) == 1 + 5


def test_events_say_what_is_held_and_for_how_long(make_net: Any) -> None:
    net = pair(make_net, TopicPolicy(rate_limit_hz=2.0))
    for number in range(3):
        net.publish("a", "video", bytes([number]), "b")
    net.publish("a", "log", b"no limit", "b")
    net.run(2.0)
    held = net.of("a", MessageHeld)
    released = net.of("a", MessageReleased)
    assert [event.message_id for event in held] == [event.message_id for event in released]
    assert len(held) == 2, "the first leaves at once, the other topic has no limit"
    assert {event.topic for event in held} == {"video"}
    assert [event.held_s for event in released] == pytest.approx([0.5, 1.0], abs=0.03)
