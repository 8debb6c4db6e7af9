"""Bridges to a slow line: who takes turns there, who waits where, what is told and sought."""

from __future__ import annotations

from typing import Any

from udp_mesh.core import wire
from udp_mesh.core.events import PeerUp

FAST, SLOW = 0, 1


def test_messages_are_cut_anew_when_the_link_behind_a_bridge_takes_less(places: Any) -> None:
    net = places({"rover": (FAST,), "bridge": (FAST, SLOW), "sensor": (SLOW,)})
    net.start("bridge")
    net.meet()
    net.cores["bridge"].add_carrier(SLOW, mtu_bytes=180, rate_bps=5000.0)
    net.run(3.0)
    net.publish("rover", "t", bytes(1000), to="sensor")
    net.run(20.0)
    assert [len(event.payload) for event in net.delivered("sensor")] == [1000]
    assert net.cores["bridge"].stats().get("bridge_too_large", 0) == 0


def test_the_beacons_of_a_bridge_are_never_left_out(places: Any) -> None:
    net = places({"a": (FAST,), "bridge": (FAST, 2), "b": (2,)})
    net.start("bridge")
    net.meet()
    net.run(3.0)
    for name in "ab":
        net.every(0.1, lambda name=name: net.publish("bridge", "t", b"x", to=name), until_s=net.now + 20.0)
    net.sent["bridge"].clear()
    net.run(20.0)
    beacons = [packet for _at, packet in net.packets("bridge") if packet.beacons and packet.is_broadcast]
    assert len(beacons) >= 2 * 17  # each second on each carrier, give or take a tenth
    assert all(packet.links for packet in beacons)


def test_own_messages_and_passed_on_ones_of_one_priority_share_a_slow_line(places: Any) -> None:
    net = places({"rover": (FAST,), "bridge": (FAST, SLOW), "sensor": (SLOW,)})
    net.start("bridge")
    net.meet()
    for sender in ("rover", "bridge"):
        net.publish(sender, "bulk", bytes(5000), to="sensor", priority=9)
    begun_at_s = net.now
    net.run(120.0)
    ends = {event.source: event.now - begun_at_s for event in net.delivered("sensor")}
    assert ends.keys() == {"rover", "bridge"}
    assert max(ends.values()) < 1.6 * min(ends.values())


def test_a_bridge_searches_for_whom_others_seek_and_shows_every_path(places: Any) -> None:
    net = places({"rover": (FAST,), "bridge": (FAST, SLOW), "sensor": (SLOW,)})
    net.start("bridge")
    net.meet()
    net.publish("rover", "t", b"x", to="sensor")
    net.run(5.0)
    by_name = {status.name: status for status in net.cores["rover"].peers(now=net.now)}
    ((direct,), (bridged,)) = by_name["bridge"].paths, by_name["sensor"].paths
    assert (direct.address, direct.via, direct.in_use) == ("bridge", "", True)
    assert (bridged.address, bridged.via, bridged.in_use, bridged.rate_bps) == ("bridge", "bridge", True, 5000.0)
    for _ in range(20):  # between them broadcasts that stay behind, which are no losses
        net.publish("sensor", "t", b"x", to="all")
        net.run(2.0)
    (bridged,) = next(s for s in net.cores["rover"].peers(now=net.now) if s.name == "sensor").paths
    assert bridged.loss_ratio == 0
    tag = wire.tag_of(net.cores["sensor"].epoch)
    net.deaf.add(("sensor", SLOW))
    net.publish("rover", "t", b"x", to="sensor")
    net.run(30.0)
    net.sent["bridge"].clear()
    net.run(20.0)
    sought = [d for _at, d in net.sent["bridge"] if (packet := wire.dissect(d.data)) and tag in packet.probes]
    assert any(d.path.carrier == SLOW for d in sought)


def test_what_is_behind_a_slow_link_waits_at_its_sender(places: Any) -> None:
    net = places({"rover": (FAST,), "bridge": (FAST, SLOW), "sensor": (SLOW,)})
    net.start("bridge")
    net.meet()
    net.run(2.0)
    net.sent["rover"].clear()
    net.publish("rover", "bulk", bytes(9000), to="sensor", priority=9)
    net.run(8.0)
    sent_bytes = sum(len(d.data) for _at, d in net.sent["rover"] if d.path.via)
    assert 0.6 * 5000 < 8 * sent_bytes / 8 < 1.05 * 5000  # acknowledgements and beacons share the line
    assert net.cores["bridge"].stats()["bridge_dropped"] == 0


def test_a_newcomer_behind_a_bridge_is_known_at_once(places: Any) -> None:
    net = places({"rover": (FAST,), "bridge": (FAST, 2), "far": (2,)})
    net.start("bridge")
    net.meet()
    for _ in range(6):  # without a word of the bridge it would be its next beacon, within a second
        net.stop("far")
        net.run(5.3)
        epoch = net.add("far").epoch
        net.run(0.3)
        up = [event for event in net.of("rover", PeerUp) if event.peer == "far"]
        assert up[-1].epoch == epoch
        assert net.cores["rover"].is_online("far")
