"""The node's one queue: order, limits, policies, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from udp_mesh.core import events
from udp_mesh.core.events import DropReason
from udp_mesh.core.mesh import Refused
from udp_mesh.core.settings import Keep, Offline, Reliability, TopicPolicy


def pair(make_net: Any, seed: int = 1, **settings: object) -> Any:
    net = make_net(seed=seed)
    net.add("a", trace_fragments=True, **settings)
    net.add("b", **settings)
    net.meet()
    net.run(0.2)
    return net


def drops(net: Any, name: str = "a") -> list[tuple[str, DropReason]]:
    return [(event.topic, event.reason) for event in net.of(name, events.MessageDropped)]


@given(
    seed=st.integers(0, 1000),
    messages=st.lists(st.tuples(st.integers(0, 3), st.integers(1, 8000)), min_size=2, max_size=15),
)
@settings(deadline=None, max_examples=30)
def test_urgent_fragments_leave_first_and_equals_in_order(
    make_net: Any, seed: int, messages: list[tuple[int, int]]
) -> None:
    net = pair(make_net, seed)
    for priority, size in messages:
        net.publish("a", f"p{priority}", bytes(size), "b", priority=priority)
    net.run(5.0)
    sent = [(e.priority, e.message_id, e.fragment_index) for e in net.of("a", events.FragmentSent)]
    assert sent == sorted(sent)


def test_an_urgent_message_preempts_bulk_between_fragments(make_net: Any) -> None:
    net = pair(make_net)
    net.link("a", "b", rate_bps=5e6)
    net.publish("a", "bulk", bytes(500_000), "b", priority=9)
    net.run(0.4)
    published_s = net.now
    net.publish("a", "urgent", b"!", "b", priority=1)
    net.run(0.0)
    later = [event for event in net.of("a", events.FragmentSent) if event.now >= published_s]
    assert later[0].priority == 1
    assert later[0].now == published_s


def test_fifo_mode_keeps_the_order_of_publication(make_net: Any) -> None:
    net = pair(make_net, prioritise=False)
    for priority in (9, 1, 5, 0):
        net.publish("a", f"p{priority}", bytes(3000), "b", priority=priority)
    net.run(2.0)
    assert [message.priority for message in net.delivered("b")] == [9, 1, 5, 0]


def test_a_blocked_peer_does_not_block_the_others(make_net: Any) -> None:
    net = make_net()
    for name in ("a", "b", "c"):
        net.add(name, window=1)
    net.meet()
    net.link("a", "b", is_cut=True)
    net.publish("a", "t", bytes(10_000), "b", priority=0)
    net.run(0.05)
    net.publish("a", "t", b"to c", "c", priority=9)
    net.run(0.1)
    assert [message.payload for message in net.delivered("c")] == [b"to c"]


def test_window_is_never_exceeded(make_net: Any) -> None:
    net = make_net(delay_s=0.05)
    net.keep_datagrams = True
    net.add("a", window=3)
    net.add("b", window=3)
    net.meet()
    net.run(1.0)
    began_s = net.now
    net.publish("a", "t", bytes(40_000), "b")
    net.run(5.0)
    assert len(net.delivered("b")) == 1
    times = [at for at, packet in net.packets("a") if packet.fragments and at >= began_s]
    for first, fourth in zip(times, times[3:], strict=False):
        assert fourth - first >= 0.1 - 1e-9  # three per round trip


def test_latest_replaces_what_waits_but_not_what_is_under_way(make_net: Any) -> None:
    net = pair(make_net, window=1)
    for number in range(5):
        net.publish("a", "video", bytes([number]) * 5000, "b", keep=Keep.LATEST)
        net.run(0.001)
    net.run(3.0)
    assert [message.payload[0] for message in net.delivered("b")] == [0, 4]
    assert drops(net) == [("video", DropReason.SUPERSEDED)] * 3


def test_a_lifetime_that_is_over_drops_the_message_on_time(make_net: Any) -> None:
    net = pair(make_net, window=1)
    net.link("a", "b", is_cut=True)
    published_s = net.now
    net.publish("a", "t", b"x", "b", lifetime_s=0.25)
    net.run(0.4)
    net.link("a", "b", is_cut=False)
    net.run(2.0)
    assert net.delivered("b") == []
    (dropped,) = net.of("a", events.MessageDropped)
    assert dropped.reason is DropReason.EXPIRED
    assert dropped.now - published_s == pytest.approx(0.25)


def test_best_effort_is_not_sent_again(make_net: Any) -> None:
    net = pair(make_net)
    net.one_way("a", "b", is_cut=True)
    net.publish("a", "t", bytes(3000), "b", reliability=Reliability.BEST_EFFORT)
    net.run(0.02)
    net.one_way("a", "b", is_cut=False)
    net.run(2.0)
    assert net.delivered("b") == []
    assert drops(net) == [("t", DropReason.LOST)]
    assert "fragments_retransmitted" not in net.cores["a"].stats()


def test_a_full_queue_drops_the_least_urgent_that_has_not_begun(make_net: Any) -> None:
    net = pair(make_net, queue_bytes=100_000, window=1)
    for topic, priority in (("under way", 9), ("bulk1", 9), ("map", 5), ("bulk2", 9)):
        net.publish("a", topic, bytes(24_000), "b", priority=priority)
        net.run(0.001)
    net.publish("a", "urgent", bytes(24_000), "b", priority=1)
    assert net.cores["a"].stats()["queued_bytes"] <= 100_000
    net.run(0.0)
    assert drops(net) == [("bulk1", DropReason.QUEUE_FULL)]
    net.publish("a", "urgent", bytes(50_000), "b", priority=1)
    net.run(0.0)
    assert [topic for topic, _reason in drops(net)][1:] == ["bulk2", "under way"]
    with pytest.raises(Refused, match="queue_full"):
        net.publish("a", "late bulk", bytes(60_000), "b", priority=9)


def test_a_publisher_that_waits_is_refused_instead_of_dropping(make_net: Any) -> None:
    net = pair(make_net, queue_bytes=65_536, window=1)
    policy = TopicPolicy()
    for _ in range(2):
        net.cores["a"].publish("t", bytes(30_000), to="b", policy=policy, may_drop=False, now=net.now)
    with pytest.raises(Refused, match="queue_full"):
        net.cores["a"].publish("t", bytes(30_000), to="b", policy=policy, may_drop=False, now=net.now)
    assert drops(net) == []


def test_messages_of_one_topic_are_limited(make_net: Any) -> None:
    net = pair(make_net, queue_messages=3, window=1)
    for number in range(6):
        net.publish("a", "t", bytes([number]) * 2000, "b")
    net.run(3.0)
    assert drops(net) == [("t", DropReason.QUEUE_FULL)] * 3
    assert [message.payload[0] for message in net.delivered("b")] == [3, 4, 5]


@pytest.mark.parametrize(
    ("to", "topic", "size", "reason"),
    [
        ("nobody", "t", 1, "unknown_peer"),
        ("a", "t", 1, "own_name"),
        ("b", "", 1, "bad_topic"),
        ("b", "t" * 256, 1, "bad_topic"),
        ("b", "t", 16 * 1024 * 1024 + 1, "too_large"),
    ],
)
def test_what_cannot_be_sent_is_refused_with_its_reason(
    make_net: Any, to: str, topic: str, size: int, reason: str
) -> None:
    net = pair(make_net)
    with pytest.raises(Refused, match=reason):
        net.publish("a", topic, bytes(size), to)
    assert net.cores["a"].stats()[f"refused_{reason}"] == 1


def test_memory_stays_bounded_while_an_offline_peer_is_addressed_for_hours(make_net: Any) -> None:
    net = pair(make_net)
    net.stop("b")
    net.run(5.0)
    core = net.cores["a"]
    policy = TopicPolicy(offline=Offline.LATEST, lifetime_s=3600.0)
    for _ in range(20_000):
        core.publish("t", b"x" * 10, to="b", policy=policy, now=net.now)
        while core.next_event() is not None:
            pass
    assert core.queue_depths() == {"t": 1}
    assert len(core._outbox._deadlines) < 1000
    assert sum(map(len, core._state.scheduler._heaps.values())) < 1000


def test_settings_change_while_running(make_net: Any) -> None:
    net = pair(make_net)
    core = net.cores["a"]
    core.reconfigure(replace(core.settings, window=3), now=net.now)
    assert core.peers(now=net.now)[0].cwnd_bytes == 3 * 1400
    net.publish("a", "t", bytes(30_000), "b")
    net.run(2.0)
    assert len(net.delivered("b")) == 1
    with pytest.raises(ValueError, match="name"):
        core.reconfigure(replace(core.settings, name="z"), now=net.now)


def test_idle_links_are_quiet(make_net: Any) -> None:
    net = make_net()
    net.keep_datagrams = True
    net.add("a")
    net.add("b")
    net.meet()
    net.run(0.5)
    before = len(net.sent["a"])
    net.run(10.0)
    times = [at for at, _datagram in net.sent["a"][before:]]
    assert 9 <= len(times) <= 12
    assert all(0.89 <= b - a <= 1.11 for a, b in pairwise(times))
