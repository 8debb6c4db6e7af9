"""Who is online: discovery, restarts, outages, probing, names."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from udp_mesh.core import events, wire
from udp_mesh.core.events import DropReason, PeerDownReason, PeerUpReason
from udp_mesh.core.mesh import Path, Refused
from udp_mesh.core.settings import Keep, Offline


def pair(make_net: Any, seed: int = 1, **settings: object) -> Any:
    net = make_net(seed=seed)
    net.keep_datagrams = True
    net.add("a", **settings)
    net.add("b", **settings)
    net.meet()
    net.run(0.2)
    return net


def presence(net: Any, name: str = "a") -> list[object]:
    return [event.reason for event in net.events[name] if isinstance(event, events.PeerUp | events.PeerDown)]


def test_a_node_is_discovered_within_one_beacon_and_knows_all_others_at_once(make_net: Any) -> None:
    net = make_net()
    for number in range(5):
        net.add(f"n{number}")
    net.meet(0.2)
    net.run(1.0)
    net.add("late")
    began_s = net.now
    net.meet(0.2)
    assert net.now - began_s < 0.05


def test_an_idle_peer_is_offline_after_three_missed_beacons(make_net: Any) -> None:
    net = pair(make_net)
    net.run(0.6)
    net.link("a", "b", is_cut=True)
    cut_s = net.now
    net.run(5.0)
    (down,) = net.of("a", events.PeerDown)
    assert down.reason is PeerDownReason.BEACONS_MISSED
    assert 2.0 < down.now - cut_s < 4.0


def test_a_peer_that_owes_an_answer_is_offline_after_half_a_second(make_net: Any) -> None:
    net = pair(make_net)
    net.link("a", "b", is_cut=True)
    net.publish("a", "t", b"x", "b")
    cut_s = net.now
    net.run(1.0)
    (down,) = net.of("a", events.PeerDown)
    assert down.reason is PeerDownReason.SILENT
    assert down.now - cut_s == pytest.approx(0.5, abs=0.01)


def test_offline_peers_get_no_unicast_and_one_broadcast_probe_for_all(make_net: Any) -> None:
    net = make_net()
    net.keep_datagrams = True
    for name in ("a", "b", "c"):
        net.add(name)
    net.meet()
    net.stop("b")
    net.stop("c")
    for name in ("b", "c"):
        net.publish("a", "t", b"kept", name)
    net.run(1.0)
    before = len(net.sent["a"])
    net.run(1.0)
    later = net.sent["a"][before:]
    assert all(datagram.path.address == "" for _at, datagram in later)
    probes = [(at, packet) for at, packet in net.packets("a")[before:] if packet.probes]
    assert 38 <= len(probes) <= 42
    assert all(len(packet.probes) == 2 for _at, packet in probes)
    assert max(b - a for (a, _), (b, _) in pairwise(probes)) < 0.026


def test_probing_slows_after_two_minutes_and_ends_after_ten_without_traffic(make_net: Any) -> None:
    net = pair(make_net)
    net.run(0.5)
    net.publish("a", "t", b"x", "b", lifetime_s=1.0)
    net.stop("b")
    net.run(0.6)

    def probes_per_second() -> float:
        before = len(net.packets("a"))
        net.run(10.0)
        return sum(bool(packet.probes) for _at, packet in net.packets("a")[before:]) / 10

    assert probes_per_second() == pytest.approx(40, abs=1)
    net.run(112.0)
    assert probes_per_second() == pytest.approx(1, abs=0.1)
    net.run(480.0)
    assert probes_per_second() == 0


@pytest.mark.parametrize("seed", range(5))
def test_after_an_outage_fresh_telemetry_arrives_within_a_tenth_of_a_second(make_net: Any, seed: int) -> None:
    assert reconnect_delay_s(make_net, seed=seed, probe=True) <= 0.1


def test_without_probing_the_return_waits_for_a_beacon(make_net: Any) -> None:
    delays = [reconnect_delay_s(make_net, seed=seed, probe=False) for seed in range(5)]
    assert max(delays) > 0.2


def reconnect_delay_s(make_net: Any, *, seed: int, probe: bool) -> float:
    net = pair(make_net, seed, probe=probe)
    published: dict[int, float] = {}

    def telemetry() -> None:
        with contextlib.suppress(Refused):
            published[net.publish("a", "telemetry", bytes(200), "b", priority=1)] = net.now

    net.every(0.05, telemetry, until_s=net.now + 25)
    net.run(2.0 + net.rng.random())
    net.link("a", "b", is_cut=True)
    net.run(15.0)
    net.link("a", "b", is_cut=False)
    restored_s = net.now
    net.run(4.0)
    return min(m.now for m in net.delivered("b") if published[m.message_id] >= restored_s) - restored_s


def test_what_was_queued_is_delivered_after_the_outage_and_nothing_twice(make_net: Any) -> None:
    net = pair(make_net)
    net.link("a", "b", rate_bps=1e6)
    for number in range(3):
        net.publish("a", "map", bytes([number]) * 30_000, "b")
    net.run(0.3)
    net.link("a", "b", is_cut=True)
    net.run(15.0)
    assert presence(net)[-1] is PeerDownReason.SILENT
    net.link("a", "b", is_cut=False)
    net.run(3.0)
    assert [message.payload[0] for message in net.delivered("b")] == [0, 1, 2]
    assert net.of("a", events.MessageDropped) == []
    assert presence(net)[-1] is PeerUpReason.RETURNED


def test_new_messages_for_an_offline_peer_are_refused_or_the_latest_is_kept(make_net: Any) -> None:
    net = pair(make_net)
    net.link("a", "b", is_cut=True)
    net.run(5.0)
    with pytest.raises(Refused, match="peer_offline"):
        net.publish("a", "t", b"discarded", "b")
    with pytest.raises(Refused, match="peer_offline"):
        net.publish("a", "t", bytes(5000), "all")
    for number in range(3):
        net.publish("a", "pose", bytes([number]), "b", offline=Offline.LATEST, keep=Keep.ALL)
    net.link("a", "b", is_cut=False)
    net.run(2.0)
    assert [message.payload for message in net.delivered("b")] == [b"\x02"]
    assert [event.reason for event in net.of("a", events.MessageDropped)] == [DropReason.SUPERSEDED] * 2


@pytest.mark.parametrize("who", ["a", "b"])
def test_a_restart_is_seen_at_once_by_either_side(make_net: Any, who: str) -> None:
    net = pair(make_net)
    other = "b" if who == "a" else "a"
    net.stop(who)
    net.run(0.1)
    net.add(who)
    restarted_s = net.now
    net.run(0.1)
    (up,) = [event for event in net.of(other, events.PeerUp) if event.reason is PeerUpReason.RESTARTED]
    assert up.now - restarted_s < 0.05
    net.publish(who, "t", b"1", other)
    net.publish(other, "t", b"2", who)
    net.run(0.2)
    assert [m.payload for m in net.delivered(other)] == [b"1"]
    assert [m.payload for m in net.delivered(who)] == [b"2"]


def test_a_receiver_restart_ends_sent_messages_as_unknown_and_resends_the_others(make_net: Any) -> None:
    net = pair(make_net)
    net.one_way("b", "a", is_cut=True)
    net.publish("a", "sent whole", b"x", "b", priority=1)
    net.publish("a", "begun", bytes(100_000), "b", priority=2)
    net.publish("a", "waiting", b"y", "b", priority=3)
    net.run(0.05)
    net.stop("b")
    net.link("a", "b", is_cut=False)
    net.add("b")
    net.run(2.0)
    dropped = net.of("a", events.MessageDropped)
    assert [(event.topic, event.reason) for event in dropped] == [("sent whole", DropReason.PEER_RESTARTED)]
    assert [(m.topic, len(m.payload)) for m in net.delivered("b")][-2:] == [("begun", 100_000), ("waiting", 1)]


def test_packets_of_an_epoch_that_was_replaced_are_not_believed(make_net: Any) -> None:
    net = pair(make_net)
    net.publish("a", "t", b"old", "b")
    net.run(0.2)
    stragglers = [datagram for _at, datagram in net.sent["a"]]
    net.stop("a")
    net.add("a")
    net.meet()
    core = net.cores["b"]
    up_events = len(net.of("b", events.PeerUp))
    for datagram in stragglers:
        core.receive_datagram(datagram.data, Path(0, "a"), now=net.now)
    net.run(1.0)
    assert len(net.delivered("b")) == 1
    assert len(net.of("b", events.PeerUp)) == up_events
    assert core.stats()["retired_epoch"] > 0


def test_a_straggler_that_retired_the_present_epoch_is_found_out(make_net: Any) -> None:
    """Both restart; the first that b hears of a's new life is followed by what was still under way of the old one."""
    net = pair(make_net)
    stragglers = [datagram for _at, datagram in net.sent["a"]]
    for name in ("a", "b"):
        net.stop(name)
        net.add(name)
    net.meet()
    core = net.cores["b"]
    for datagram in stragglers:
        core.receive_datagram(datagram.data, Path(0, "a"), now=net.now)
    net.run(10.0)
    net.publish("b", "t", b"now", "a")
    net.run(1.0)
    assert [message.payload for message in net.delivered("a")] == [b"now"]


def test_a_peer_that_does_not_hear_us_does_not_flap(make_net: Any) -> None:
    net = pair(make_net)
    net.one_way("a", "b", is_cut=True)
    net.every(0.05, lambda: try_publish(net), until_s=net.now + 20)
    net.run(20.0)
    assert 1 <= len(net.of("a", events.PeerDown)) <= 2
    net.one_way("a", "b", is_cut=False)
    assert net.run(0.15, until=lambda: net.cores["a"].peers(now=net.now)[0].online)


def try_publish(net: Any) -> None:
    with contextlib.suppress(Refused):
        net.publish("a", "t", b"x", "b")


def test_two_nodes_with_one_name_are_reported(make_net: Any) -> None:
    net = pair(make_net)
    twin = make_net(seed=9).add("b")
    hello = twin.datagrams_to_send(now=100.0)[0].data
    net.cores["b"].receive_datagram(hello, Path(0, "elsewhere"), now=net.now)
    net.run(0.0)
    (conflict,) = net.of("b", events.NameConflict)
    assert (conflict.peer, conflict.address) == ("b", "elsewhere")
    net.cores["a"].receive_datagram(hello, Path(0, "elsewhere"), now=net.now)
    net.run(6.0)
    assert net.of("a", events.NameConflict), "the earlier holder of the name still sends"


def test_a_peer_whose_address_changes_is_followed(make_net: Any) -> None:
    net = pair(make_net)
    beacon = wire.encode_header(
        epoch=net.cores["b"].epoch, destination_tag=0, packet_number=9999, flags=wire.FLAG_UNNUMBERED
    ) + wire.encode_hello(name="b", beacon_interval_s=1.0, floor=0)
    net.cores["a"].receive_datagram(beacon, Path(0, "new address"), now=net.now)
    assert net.cores["a"].peers(now=net.now)[0].address == "new address"
    net.run(0.0)
    (changed,) = net.of("a", events.PathChanged)
    assert (changed.address_from, changed.address_to) == ("b", "new address")


def test_a_second_carrier_takes_over_when_the_first_falls_silent(make_net: Any) -> None:
    net = pair(make_net)
    core = net.cores["a"]
    beacon = wire.encode_header(
        epoch=net.cores["b"].epoch, destination_tag=0, packet_number=9999, flags=wire.FLAG_UNNUMBERED
    ) + wire.encode_hello(name="b", beacon_interval_s=1.0, floor=0)
    core.add_carrier(1)
    core.receive_datagram(beacon, Path(1, "b1"), now=net.now)
    assert core.peers(now=net.now)[0].carrier == 0
    net.stop("b")
    net.run(2.6)
    core.receive_datagram(beacon, Path(1, "b1"), now=net.now)
    assert core.peers(now=net.now)[0].carrier == 1


def test_probing_can_be_switched_off_while_running(make_net: Any) -> None:
    net = pair(make_net)
    net.stop("b")
    net.publish("a", "t", b"x", "b")
    net.run(1.0)
    core = net.cores["a"]
    core.reconfigure(replace(core.settings, probe=False), now=net.now)
    before = len(net.packets("a"))
    net.run(5.0)
    assert not any(packet.probes for _at, packet in net.packets("a")[before:])


def test_a_node_that_was_asleep_gives_its_peers_a_moment(make_net: Any) -> None:
    net = pair(make_net)
    net.publish("a", "t", b"x", "b")
    net.run(0.0)
    core = net.cores["a"]
    asleep_until_s = net.now + 3.0
    core.handle_timer(now=asleep_until_s)
    assert core.peers(now=asleep_until_s)[0].online
    core.handle_timer(now=asleep_until_s + 0.101)
    assert not core.peers(now=asleep_until_s + 0.101)[0].online
