"""What events tell of a message that is begun anew, that is tracked, or that ends without an acknowledgement."""

from __future__ import annotations

from typing import Any

import pytest

from udp_mesh.core import events
from udp_mesh.core.events import DropReason
from udp_mesh.core.mesh import Refused
from udp_mesh.core.settings import Keep


def pair(make_net: Any, **link: float) -> Any:
    net = make_net(**link)
    net.add("a")
    net.add("b")
    net.meet()
    return net


def forget_partials(net: Any, name: str) -> None:
    """As if nothing had come of any partial message for too long."""
    for peer in net.cores[name]._state.peers.values():
        peer.session.reassembler.purge_stale(now=float("inf"), is_online=True)


def test_a_message_that_is_begun_anew_keeps_its_id_and_its_place(make_net: Any) -> None:
    net = pair(make_net, delay_s=0.005, rate_bps=1e6)
    first = net.publish("a", "bulk", bytes(60_000), "b", priority=9)
    net.run(0.1)
    second = net.publish("a", "bulk", bytes(60_001), "b", priority=9)
    forget_partials(net, "b")
    net.run(10.0)
    (anew,) = net.of("a", events.MessageBegunAnew)
    assert (anew.message_id, anew.peer) == (first, "b")
    assert anew.wire_id > second
    queued, acked = ([e.message_id for e in net.of("a", kind)] for kind in (events.MessageQueued, events.MessageAcked))
    assert queued == acked == [first, second]
    assert [len(m.payload) for m in net.delivered("b")] == [60_000, 60_001]
    assert net.cores["a"].stats()["queued_bytes"] == 0


def test_an_older_message_that_would_begin_anew_yields_to_a_newer_one_of_its_topic(make_net: Any) -> None:
    net = pair(make_net, delay_s=0.005, rate_bps=1e6)
    older = net.publish("a", "photo", bytes(60_000), "b", keep=Keep.LATEST)
    net.run(0.1)
    newer = net.publish("a", "photo", bytes(50_000), "b", keep=Keep.LATEST)
    forget_partials(net, "b")
    net.run(5.0)
    assert [(e.message_id, e.reason) for e in net.of("a", events.MessageDropped)] == [(older, DropReason.SUPERSEDED)]
    assert [e.message_id for e in net.of("a", events.MessageAcked)] == [newer]


def test_a_tracked_message_for_all_is_acknowledged_by_each(make_net: Any) -> None:
    net = make_net(loss_ratio=0.3, delay_s=0.005)
    for name in ("a", "b", "c"):
        net.add(name)
    with pytest.raises(Refused, match="peer_offline"):
        net.publish("a", "t", b"nobody is there", "all", is_tracked=True)
    net.meet(6.0)
    message_id = net.publish("a", "t", b"x", "all", is_tracked=True)
    assert net.cores["a"].destinations(message_id) == ["b", "c"]
    broadcast = net.publish("a", "t", b"y", "all")
    assert net.cores["a"].destinations(broadcast) == ["all"]
    net.run(5.0)
    assert sorted((e.message_id, e.peer) for e in net.of("a", events.MessageAcked)) == [
        (message_id, "b"),
        (message_id, "c"),
    ]
    assert net.cores["a"].destinations(message_id) == []


def test_what_ended_unacknowledged_says_whether_it_may_have_arrived(make_net: Any) -> None:
    net = pair(make_net, delay_s=0.005, rate_bps=1e6)
    net.one_way("b", "a", is_cut=True)
    net.publish("a", "left", b"x", "b", priority=1, lifetime_s=0.3)
    net.publish("a", "waited", bytes(100_000), "b", priority=9, lifetime_s=0.3)
    net.run(0.4)
    assert {e.topic: (e.reason, e.may_have_arrived) for e in net.of("a", events.MessageDropped)} == {
        "left": (DropReason.EXPIRED, True),
        "waited": (DropReason.EXPIRED, False),
    }
    assert [m.topic for m in net.delivered("b")] == ["left"]


def test_what_a_rate_limit_holds_is_held_under_its_new_id_too(make_net: Any) -> None:
    net = pair(make_net, delay_s=0.005)
    for number in range(3):
        net.publish("a", "map", bytes([number]), "b", rate_limit_hz=1.0)
    outbox = net.cores["a"]._outbox
    held = list(net.cores["a"]._state.peers["b"].lane.transfers.values())[-1]
    outbox.start_over(held, now=net.now)
    net.run(1.5)
    assert len(net.delivered("b")) == 2
    net.run(1.0)
    assert [m.payload[0] for m in net.delivered("b")] == [0, 1, 2]


def test_copies_are_told_from_retransmissions(make_net: Any) -> None:
    net = pair(make_net, delay_s=0.02)
    net.publish("a", "t", b"x", "b", redundancy=3)
    net.run(1.0)
    assert len(net.of("a", events.FragmentCopied)) == 2
    assert net.of("a", events.FragmentRetransmitted) == []
    assert net.cores["a"].stats()["fragments_copied"] == 2
    net.one_way("a", "b", is_cut=True)
    net.publish("a", "t", b"y", "b")
    net.at(net.now + 0.05, lambda: net.one_way("a", "b", is_cut=False))
    net.run(1.0)
    assert len(net.of("a", events.FragmentRetransmitted)) == 1
    assert len(net.delivered("b")) == 2
