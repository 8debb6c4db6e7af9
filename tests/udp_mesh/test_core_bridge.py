"""Bridges: nodes that cannot hear each other meet over one that hears both, and what they are promised holds."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from udp_mesh.core import wire
from udp_mesh.core.carriers import Path
from udp_mesh.core.events import MessageAcked, MessageDropped, MessageQueued, PeerDown, PeerUp

KEY = bytes(range(32))
RADIO, SERIAL, OTHER = 0, 1, 2
SERIAL_BPS = 5000.0

LINE = {"rover": (RADIO,), "bridge": (RADIO, SERIAL), "sensor": (SERIAL,)}


@pytest.mark.parametrize("keys", [(), (KEY,)], ids=["plain", "sealed"])
def test_a_node_on_a_slow_line_reaches_the_rest(places: type[Any], keys: tuple[bytes, ...]) -> None:
    net = places(LINE)
    net.start("bridge", keys=keys)
    net.meet()
    for sender, receiver in (("rover", "sensor"), ("sensor", "rover")):
        net.publish(sender, "report", bytes(2000), to=receiver, priority=9)
        net.publish(sender, "telemetry", bytes(50), to=receiver, priority=1)
    net.run(30.0)
    for name in ("rover", "sensor"):
        assert [len(event.payload) for event in net.delivered(name)] == [50, 2000]
        assert len(net.of(name, MessageAcked)) == 2
        assert net.of(name, PeerDown) == net.of(name, MessageDropped) == []


def test_without_the_setting_nothing_is_passed_on(places: type[Any]) -> None:
    net = places(LINE)
    net.start()
    net.run(20.0)
    assert [peer.name for peer in net.cores["rover"].peers(now=net.now)] == ["bridge"]
    assert [peer.name for peer in net.cores["sensor"].peers(now=net.now)] == ["bridge"]


def test_an_idle_neighbour_behind_a_bridge_stays_online_and_beacons_do_not_cross(places: type[Any]) -> None:
    net = places(LINE)
    net.start("bridge")
    net.meet()
    net.run(5.0)
    net.sent["bridge"].clear()
    net.run(120.0)
    assert not [event for name in LINE for event in net.of(name, PeerDown)]
    serial = [d for _at, d in net.sent["bridge"] if d.path.carrier == SERIAL]
    assert 8 * sum(len(d.data) for d in serial) / 120 < 0.11 * SERIAL_BPS
    assert not [packet for _at, packet in net.packets("bridge") if packet.is_bridged]


def test_urgent_stays_urgent_over_the_bridge(places: type[Any]) -> None:
    net = places(LINE)
    net.start("bridge")
    net.meet()
    net.publish("rover", "bulk", bytes(8000), to="sensor", priority=9)
    net.publish("bridge", "bulk", bytes(8000), to="sensor", priority=9)
    net.run(3.0)
    urgent_at_s = net.now
    net.publish("rover", "stop", b"stop", to="sensor", priority=0)
    net.run(60.0)
    (urgent,) = net.delivered("sensor", "stop")
    bulk = net.delivered("sensor", "bulk")
    # A full datagram takes 0.41 s; one is under way, one may have been handed to the link just before.
    assert urgent.now - urgent_at_s < 1.5
    assert len(bulk) == 2
    assert min(event.now for event in bulk) > urgent.now + 5


def test_a_backlog_for_the_slow_side_leaves_the_fast_side_alone(places: type[Any]) -> None:
    where = {f"rover{n}": (RADIO,) for n in range(4)} | {"bridge": (RADIO, SERIAL), "sensor": (SERIAL,)}
    net = places(where)
    net.start("bridge")
    net.meet(60.0)
    for n in range(4):
        net.publish(f"rover{n}", "bulk", bytes(4000), to="sensor", priority=9)
    net.run(2.0)
    for _ in range(50):
        net.publish("rover0", "t", bytes(1000), to="bridge")
        net.publish("rover0", "t", bytes(1000), to="rover1")
    at_s = net.now
    net.run(90.0)
    for name in ("bridge", "rover1"):
        assert max(event.now for event in net.delivered(name, "t")) - at_s < 0.5
    assert len(net.delivered("sensor", "bulk")) == 4
    assert not [event for name in where for event in net.of(name, MessageDropped)]


@pytest.mark.parametrize("restarts", ["bridge", "sensor"])
def test_after_a_restart_what_was_promised_holds(places: type[Any], restarts: str) -> None:
    net = places(LINE)
    net.start("bridge")
    net.meet()
    net.every(2.0, lambda: net.publish("rover", "t", bytes(300), to="sensor"), until_s=net.now + 20.0)
    net.run(7.3)
    net.stop(restarts)
    net.run(3.0)
    net.add(restarts, bridge=restarts == "bridge")
    net.run(60.0)
    acked = {event.message_id for event in net.of("rover", MessageAcked)}
    unknown = {event.message_id for event in net.of("rover", MessageDropped)}
    got = [event.message_id for event in net.delivered("sensor")]
    assert len(got) == len(set(got))
    assert acked <= set(got)
    assert acked.isdisjoint(unknown)
    assert net.cores["rover"].stats()["queued_bytes"] == 0
    assert len(unknown) <= (0 if restarts == "bridge" else 2)
    assert [event.epoch for event in net.of("rover", PeerUp) if event.peer == restarts][-1] == net.cores[restarts].epoch


def test_who_returns_behind_the_bridge_is_found_at_once(places: type[Any]) -> None:
    net = places(LINE)
    net.start("bridge")
    net.meet()
    net.publish("rover", "t", b"before", to="sensor")
    net.run(5.0)
    net.deaf.add(("sensor", SERIAL))
    net.publish("rover", "t", b"in the outage", to="sensor")
    net.run(20.0)
    assert [event.peer for event in net.of("rover", PeerDown)] == ["sensor"]
    back_at_s = net.now
    net.deaf.clear()
    net.run(30.0)
    before, after = net.delivered("sensor")
    assert (before.payload, after.payload) == (b"before", b"in the outage")
    assert after.now - back_at_s < 3.0  # the line's probes are two seconds apart


TWO = {"rover": (RADIO,), "bridge1": (RADIO, OTHER), "bridge2": (RADIO, OTHER), "far": (OTHER,)}


def test_two_bridges_pass_a_broadcast_on_once_and_nothing_goes_in_circles(places: type[Any]) -> None:
    net = places(TWO)
    net.start("bridge1", "bridge2")
    net.meet()
    net.run(5.0)
    for name in TWO:
        net.sent[name].clear()
    for _ in range(10):
        net.publish("rover", "t", b"to all", to="all")
        net.publish("far", "t", bytes(3000), to="all")
        net.run(0.1)
    net.run(3.0)
    crossed = [packet for name in TWO for _at, packet in net.packets(name) if packet.is_bridged and packet.is_broadcast]
    assert len(crossed) == 10
    assert len(net.delivered("far")) == len(net.delivered("rover")) == 10
    for name in ("bridge1", "bridge2"):
        assert len(net.delivered(name)) == 20
    total = sum(len(net.sent[name]) for name in TWO)
    assert total < 400, "a loop would never end"


def test_a_broadcast_goes_on_once_and_only_to_where_its_sender_is_not_heard(places: type[Any]) -> None:
    net = places({"rover": (RADIO, OTHER), "bridge": (RADIO, SERIAL, OTHER), "far": (OTHER,), "sensor": (SERIAL,)})
    net.start("bridge")
    assert net.run(20.0, until=lambda: {"rover", "bridge"} <= {p.name for p in net.cores["sensor"].peers(now=net.now)})
    net.run(3.0)
    net.sent["bridge"].clear()
    for _ in range(5):
        net.publish("rover", "t", b"to all", to="all")
        net.run(1.0)
    crossed = [d for _at, d in net.sent["bridge"] if (packet := wire.dissect(d.data)) and packet.is_bridged]
    assert [d.path.carrier for d in crossed] == [SERIAL] * 5
    assert len(net.delivered("sensor")) == len(net.delivered("far")) == len(net.delivered("bridge")) == 5


def test_a_second_bridge_takes_over(places: type[Any]) -> None:
    net = places(TWO)
    net.start("bridge1", "bridge2")
    net.meet()
    net.every(0.1, lambda: net.publish("rover", "t", b"x", to="far"), until_s=net.now + 10.0)
    net.run(2.0)
    (used,) = {d.path.address for _at, d in net.sent["rover"][-5:] if d.path.address.startswith("bridge")}
    net.stop(used)
    net.run(20.0)
    sent = [event.message_id for event in net.of("rover", MessageQueued)]
    assert len(sent) >= 100
    assert sorted(event.message_id for event in net.delivered("far")) == sent
    assert len(net.of("rover", MessageAcked)) == len(sent)
    arrived = sorted(event.now for event in net.delivered("far"))
    assert max(later - earlier for earlier, later in pairwise(arrived)) < 0.4  # a probe or two


def test_a_large_team_and_a_slow_line_meet(places: type[Any]) -> None:
    where = {f"rover{n}": (RADIO,) for n in range(12)} | {"bridge": (RADIO, SERIAL), "sensor": (SERIAL,)}
    net = places(where)
    net.start("bridge")
    net.meet(60.0)
    net.run(60.0)
    assert net.of("sensor", PeerDown) == []
    net.publish("sensor", "t", b"hello", to="rover7", priority=0)
    net.run(3.0)
    assert [event.payload for event in net.delivered("rover7")] == [b"hello"]


def test_broadcasts_of_one_datagram_cross_and_longer_ones_are_sent_to_each(places: type[Any]) -> None:
    net = places(LINE)
    net.start("bridge")
    net.meet()
    for size in (50, 600):
        net.publish("rover", "t", bytes(size), to="all")
    net.publish("sensor", "t", bytes(60), to="all")
    net.run(15.0)
    assert [len(event.payload) for event in net.delivered("sensor")] == [50, 600]
    assert [len(event.payload) for event in net.delivered("rover")] == [60]


def test_who_hears_a_node_itself_does_not_use_the_bridge(places: type[Any]) -> None:
    net = places({"a": (RADIO, OTHER), "b": (RADIO, OTHER), "bridge": (RADIO, OTHER)})
    net.start("bridge")
    net.meet()
    net.publish("a", "t", bytes(5000), to="b")
    net.publish("a", "t", bytes(50), to="all")
    net.run(5.0)
    assert len(net.delivered("b")) == 2
    assert net.cores["bridge"].stats().get("bridge_passed", 0) == 0
    net.deaf |= {("a", RADIO), ("b", OTHER)}  # now only the bridge hears both
    net.publish("a", "t", bytes(5000), to="b")
    net.run(10.0)
    assert len(net.delivered("b")) == 3
    assert net.cores["bridge"].stats()["bridge_passed"] > 0
    net.deaf.clear()
    net.run(10.0)
    before = net.cores["bridge"].stats()["bridge_passed"]
    net.publish("a", "t", bytes(5000), to="b")
    net.run(3.0)
    assert len(net.delivered("b")) == 4
    assert net.cores["bridge"].stats()["bridge_passed"] == before


def test_a_recording_or_a_stranger_is_not_passed_on(places: type[Any]) -> None:
    net = places(LINE)
    net.start("bridge", keys=(KEY,))
    net.meet()
    net.run(5.0)
    bridge = net.cores["bridge"]
    passed = bridge.stats()["bridge_passed"]
    sealed = [d.data for _at, d in net.sent["rover"] if d.path.address == "bridge"]
    for data in sealed:
        bridge.receive_datagram(data, Path(RADIO, "rover"), now=net.now)
    header = wire.encode_header(
        epoch=77, destination_tag=wire.tag_of(net.cores["sensor"].epoch), packet_number=0, flags=0
    )
    bridge.receive_datagram(header + wire.PING, Path(RADIO, "evil"), now=net.now)
    assert bridge.stats()["bridge_passed"] == passed
    assert bridge.stats()["bad_replayed"] >= len(sealed) > 0
