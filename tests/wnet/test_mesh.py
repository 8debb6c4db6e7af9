"""What a mesh does for its hosts: unicast, multicast, broadcast, ARP, order of urgency, frames that share one."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest

from wnet.config import Metric
from wnet.core import wire
from wnet.core.events import AlternateUsed, LinkDown, LinkUp, RouteChanged

GROUP_IP = bytes((239, 1, 1, 1))
GROUP = bytes.fromhex("01005e010101")


def kinds(net, name: str) -> list[int]:
    """Kinds of the frames that a node has sent, as the wire has them."""
    return [outgoing.frame[14] for _at, outgoing in net.stations[name].sent]


def join(net, name: str, group: bytes = GROUP_IP) -> None:
    """Let a node's host report that it listens to a group (IGMPv2)."""
    ip = bytes((0x45, 0)) + bytes(7) + b"\x02" + bytes(10)
    frame = GROUP + net.stations[name].mac + b"\x08\x00" + ip + b"\x16\0\0\0" + group
    net.stations[name].mesh.originate(frame, now=net.now)
    net.run(0.0)


def star(make_mesh_net, seed: int = 1, **path):
    """One source whose radio reaches three receivers; the receivers do not hear each other."""
    net = make_mesh_net(seed=seed)
    for name in "srtu":
        net.add(name, rates_bps=(6_000_000, 24_000_000, 54_000_000))
    for name in "rtu":
        net.radio("s", name, **{"snr_db": 30.0, **path})
    assert net.run(5.0, until=net.all_known)
    net.run(3.0)
    return net


def test_a_frame_crosses_three_hops_unchanged(make_mesh_net) -> None:
    net = make_mesh_net()
    net.line("abcd")
    assert net.run(5.0, until=net.all_known)
    sent = net.send("a", "d", b"hello")
    net.run(0.1)
    assert [frame for _at, frame in net.stations["d"].delivered if frame == sent] == [sent]
    assert net.counts("b")["relayed"] == net.counts("c")["relayed"] == 1


def test_hosts_of_fifteen_hundred_bytes_fit_members_of_1532(make_mesh_net) -> None:
    net = make_mesh_net()
    for name in "ab":
        net.add(name, mtu=1532)
    net.radio("a", "b")
    assert net.run(5.0, until=net.all_known)
    assert net.stations["a"].mesh.mtu_bytes == 1484  # multicast carries a list
    net.send("a", "b", bytes(1480))
    net.run(0.1)
    assert len(net.got("b")) == 1
    net.send("a", "b", bytes(1481))
    assert net.counts("a")["oversized"] == 1


def test_a_seal_takes_its_bytes_of_the_hosts(make_mesh_net) -> None:
    net = make_mesh_net(key=(bytes(32),))
    net.add("a", mtu=1532)
    assert net.stations["a"].mesh.mtu_bytes == 1484 - 30
    net.add("b")
    assert net.stations["b"].mesh.mtu_bytes == 1500


def test_broadcast_reaches_everyone_once(make_mesh_net) -> None:
    net = make_mesh_net()
    net.line("abcde")
    assert net.run(5.0, until=net.all_known)
    net.run(2.0)
    net.send("c", b"\xff" * 6, b"all")
    net.run(0.1)
    assert [net.got(name) for name in "abcde"] == [[b"all"]] * 2 + [[]] + [[b"all"]] * 2
    assert [kinds(net, name).count(wire.FLOOD) for name in "ae"] == [0, 0]  # the ends relay nothing


def test_multicast_goes_to_members_only_and_once_on_a_radio(make_mesh_net) -> None:
    net = star(make_mesh_net)
    net.send("s", GROUP, b"nobody")
    assert net.counts("s")["no_member"] == 1
    for name in "rt":
        join(net, name)
    net.run(1.0)
    before = len(net.stations["s"].sent)
    net.send("s", GROUP, b"to two")
    net.run(0.1)
    frames = [o for _at, o in net.stations["s"].sent[before:] if o.frame[14] == wire.MULTICAST]
    assert [net.got(name) for name in "rtu"] == [[b"to two"], [b"to two"], []]
    assert len(frames) == 1
    assert frames[0].frame[:6] == wire.GROUP
    assert frames[0].rate_bps == 54_000_000


def test_the_rate_is_what_the_worst_of_the_next_hops_receives(make_mesh_net) -> None:
    net = star(make_mesh_net)
    net.change("s", "t", snr_db=17.0)
    for name in "rtu":
        join(net, name)
    net.run(12.0)
    net.send("s", GROUP, b"x")
    net.send("s", "r", b"y")
    rates = {o.frame[14]: o.rate_bps for _at, o in net.stations["s"].sent[-4:] if o.urgency}
    assert rates == {wire.MULTICAST: 24_000_000, wire.UNICAST: 54_000_000}


def test_who_has_not_acknowledged_gets_it_again_and_only_he(make_mesh_net) -> None:
    net = star(make_mesh_net)
    for name in "rt":
        join(net, name)
    net.run(1.0)
    net.one_way("s", "t", is_cut=True)
    net.send("s", GROUP, b"again")
    net.run(0.005)
    net.one_way("s", "t", is_cut=False)
    net.run(0.2)
    assert net.got("r") == net.got("t") == [b"again"]
    retries = [o.frame for _at, o in net.stations["s"].sent if o.frame[14] == wire.MULTICAST and not o.frame[0] & 1]
    assert net.counts("s")["retried"] == len(retries) == 1
    assert retries[0][:6] == net.stations["t"].members[0].mac
    data = wire.decode(retries[0][14:])
    assert isinstance(data, wire.Data)
    assert data.attempt == 1


def test_the_next_hops_of_one_frame_answer_one_after_the_other(make_mesh_net) -> None:
    """They hear the sender and not each other, so that no carrier sense keeps their answers apart."""
    net = star(make_mesh_net)
    for name in "rtu":
        join(net, name)
    net.run(1.0)
    before = {name: len(net.stations[name].sent) for name in "rtu"}
    net.send("s", GROUP, b"to three")
    net.run(0.01)
    answers = sorted(
        at_s
        for name, count in before.items()
        for at_s, outgoing in net.stations[name].sent[count:]
        if outgoing.frame[14] == wire.ACK
    )
    assert len(answers) == 3
    assert [later - earlier for earlier, later in pairwise(answers)] == pytest.approx([0.0005, 0.0005])
    assert net.counts("s")["retried"] == 0


def test_multicast_over_hops_branches_where_paths_part(make_mesh_net) -> None:
    net = make_mesh_net()
    net.add("s", radios=0, wires=1)
    net.add("m", radios=0, wires=3)
    for name in "rt":
        net.add(name, radios=0, wires=1)
    for a, b in ("sm", "mr", "mt"):
        net.wire(a, b)
    assert net.run(5.0, until=net.all_known)
    for name in "rt":
        join(net, name)
    net.run(1.0)
    net.send("s", GROUP, b"both")
    net.run(0.1)
    assert net.got("r") == net.got("t") == [b"both"]
    assert net.got("m") == []
    assert kinds(net, "s").count(wire.MULTICAST) == 1


def test_a_list_too_long_for_a_member_is_sent_in_parts(make_mesh_net) -> None:
    net = make_mesh_net()
    names = [f"r{n}" for n in range(6)]
    net.add("s", mtu=1540)
    for name in names:
        net.add(name, mtu=1540)
        net.radio("s", name)
    assert net.run(5.0, until=net.all_known)
    for name in names:
        join(net, name)
    net.run(1.0)
    net.send("s", GROUP, bytes(1400))
    net.send("s", GROUP, bytes(1480))
    net.run(0.2)
    assert [len(net.got(name)) for name in names] == [1] * 6  # the second leaves no room for even one address
    assert kinds(net, "s").count(wire.MULTICAST) >= 1
    assert net.counts("s")["oversized"] == 1
    assert max(len(o.frame) for _at, o in net.stations["s"].sent) <= 1540 + 14


def test_arp_for_a_known_address_never_leaves(make_mesh_net) -> None:
    net = make_mesh_net()
    net.line("abc")
    net.stations["c"].mesh.set_addresses([bytes((10, 0, 0, 3))], now=net.now)
    assert net.run(5.0, until=net.all_known)
    net.run(2.0)
    mac, before = net.stations["a"].mac, kinds(net, "a").count(wire.FLOOD)
    packet = struct.pack(
        "!HHBBH6s4s6s4s", 1, 0x0800, 6, 4, 1, mac, bytes((10, 0, 0, 1)), bytes(6), bytes((10, 0, 0, 3))
    )
    net.stations["a"].mesh.originate(b"\xff" * 6 + mac + b"\x08\x06" + packet, now=net.now)
    net.run(1.0)
    replies = [f for _at, f in net.stations["a"].delivered if f[12:14] == b"\x08\x06"]
    assert [reply[6:12] for reply in replies] == [net.stations["c"].mac]
    assert kinds(net, "a").count(wire.FLOOD) == before
    nodes = {node.mac: node.addresses for node in net.stations["c"].mesh.snapshot(now=net.now).nodes}
    assert nodes[mac] == (bytes((10, 0, 0, 1)),)  # learnt from the request, told by TC


def test_urgent_frames_overtake_on_the_way_as_at_the_source(make_mesh_net) -> None:
    net = make_mesh_net()
    net.line("abc", rate_bps=5e6, limit_frames=1000)
    assert net.run(5.0, until=net.all_known)
    net.run(2.0)
    for _ in range(150):
        net.send("a", "c", b"bulk" + bytes(1300), dscp=8)
    net.run(0.1)
    sent_at = net.now
    net.send("a", "c", b"urgent", dscp=46)
    net.run(2.0)
    arrived = dict(zip(net.got("c"), net.times("c"), strict=True))
    behind = sum(at > arrived[b"urgent"] for at in net.times("c"))
    assert arrived[b"urgent"] - sent_at < 0.1  # the bulk needs 0.33 s on each hop
    assert behind > 50


def test_the_room_that_a_member_has_is_kept_to_and_control_goes_first(make_mesh_net) -> None:
    net = make_mesh_net()
    net.line("ab")
    assert net.run(5.0, until=net.all_known)
    mesh, mac = net.stations["a"].mesh, net.stations["b"].mac
    for _ in range(5):
        mesh.originate(mac + net.stations["a"].mac + b"\x08\x00\x45\x00" + bytes(1400), now=net.now)
    assert mesh.frames_to_send(now=net.now, room=[0]) == []
    assert len(mesh.frames_to_send(now=net.now, room=[2])) == 2
    assert len(mesh.frames_to_send(now=net.now, room=None)) == 3


def test_what_waits_too_long_or_is_too_much_is_dropped_with_the_reason(make_mesh_net) -> None:
    net = make_mesh_net(queue_frames=10)
    net.line("ab")
    assert net.run(5.0, until=net.all_known)
    mesh = net.stations["a"].mesh
    for _ in range(13):
        mesh.originate(net.stations["b"].mac + net.stations["a"].mac + b"\x08\x00\x45\x00" + bytes(900), now=net.now)
    assert mesh.counts["queue_full"] == 3
    mesh.frames_to_send(now=net.now + 1.5)
    assert mesh.counts["late"] == 10


def test_small_frames_to_one_next_hop_share_a_members_frame(make_mesh_net) -> None:
    net = make_mesh_net()
    net.line("abc")
    assert net.run(5.0, until=net.all_known)
    net.run(1.0)
    mesh, before = net.stations["a"].mesh, len(net.stations["a"].sent)
    head = net.stations["c"].mac + net.stations["a"].mac + b"\x08\x00\x45\x00" + bytes(18)
    for n in range(6):
        mesh.originate(head + bytes((n,)) * 100, now=net.now)
    net.run(0.1)
    assert [len(set(payload)) for payload in net.got("c")] == [1] * 6
    data = [o for _at, o in net.stations["a"].sent[before:] if o.urgency]
    assert len(data) == 1
    assert data[0].frame[14] == wire.AGGREGATE
    assert mesh.counts["aggregated"] == 5


def test_urgent_frames_take_two_paths_where_asked(make_mesh_net) -> None:
    net = diamond(make_mesh_net, redundant_dscp=46)
    carriers = {}
    for dscp in (0, 46):
        before = {name: net.counts(name)["relayed"] for name in ("r1", "r2")}
        net.send("a", "b", b"%d" % dscp, dscp=dscp)
        net.run(0.1)
        carriers[dscp] = sum(net.counts(name)["relayed"] - before[name] for name in ("r1", "r2"))
    assert carriers == {0: 1, 46: 2}
    assert net.got("b") == [b"0", b"46"]
    assert net.counts("b")["duplicate"] >= 1
    net.stations["r1"].is_silent = True
    net.send("a", "b", b"lost on one", dscp=46)
    net.run(0.02)
    assert net.got("b")[-1] == b"lost on one"


def diamond(make_mesh_net, seed: int = 1, **config):
    """Two relays between a and b."""
    net = make_mesh_net(seed=seed, **config)
    for name in ("a", "b", "r1", "r2"):
        net.add(name, radios=0, wires=2)
    for a, b in (("a", "r1"), ("r1", "b"), ("a", "r2"), ("r2", "b")):
        net.wire(a, b)
    assert net.run(5.0, until=net.all_known)
    net.run(2.0)
    return net


def test_a_frame_under_way_to_a_silent_relay_takes_the_alternate(make_mesh_net) -> None:
    net = diamond(make_mesh_net)
    first = next(
        r for r in net.stations["a"].mesh.snapshot(now=net.now).routes if r.destination == net.stations["b"].mac
    )
    relay = next(s for s in net.stations.values() if s.mac == first.next_hop)
    assert len(first.alternates) == 1
    relay.is_silent = True
    net.send("a", "b", b"saved")
    net.run(0.09)  # before the neighbour counts as lost
    assert net.got("b") == [b"saved"]
    assert [event.alternate for event in net.told("a", AlternateUsed)] == list(first.alternates)
    assert not net.told("a", LinkDown)
    net.run(1.0)
    assert net.told("a", LinkDown)


def test_a_frame_under_way_at_the_cut_is_no_sign_of_life(make_mesh_net) -> None:
    """A neighbour that is heard but does not answer gets three times the wait of one that is silent, too."""
    net = make_mesh_net()
    net.line("ab")
    assert net.run(5.0, until=net.all_known)
    net.run(2.0)
    net.send("b", "a", b"under way")
    net.change("a", "b", is_cut=True)
    net.run(0.001)
    cut_s = net.now
    net.every(0.02, lambda: net.send("a", "b"), until_s=net.now + 1.0)
    net.run(1.0)
    assert net.got("a") == [b"under way"]
    (lost,) = net.told("a", LinkDown)
    assert lost.now - cut_s <= 0.16  # `lost_after_s` is 0.12


def test_who_is_heard_but_does_not_answer_is_lost_after_three_times_the_wait(make_mesh_net) -> None:
    net = make_mesh_net()
    net.line("ab")
    assert net.run(5.0, until=net.all_known)
    net.run(5.0)
    net.one_way("a", "b", is_cut=True)
    cut_s = net.now
    net.every(0.02, lambda: net.send("b", b"\xff" * 6), until_s=net.now + 1.0)  # asks for no acknowledgement
    net.every(0.02, lambda: net.send("a", "b"), until_s=net.now + 1.0)
    net.run(1.0)
    (lost,) = net.told("a", LinkDown)
    assert 0.36 <= lost.now - cut_s <= 0.41


def test_who_is_merely_heard_is_no_news_for_others(make_mesh_net) -> None:
    net = make_mesh_net()
    for name in "abx":
        net.add(name)
    net.radio("a", "b")
    net.radio("x", "a", is_cut=True)
    net.run(10.0)
    before = len(net.stations["a"].sent)
    net.one_way("x", "a", is_cut=False)
    assert net.run(3.0, until=lambda: len(net.stations["a"].mesh.snapshot(now=net.now).links) == 2)
    net.run(0.1)
    kinds_since = kinds(net, "a")[before:]
    assert wire.HELLO in kinds_since
    assert wire.TC not in kinds_since


def test_events_tell_of_links_and_routes(make_mesh_net) -> None:
    net = diamond(make_mesh_net)
    assert len(net.told("a", LinkUp)) == 2
    net.send("a", "b")
    route = net.told("a", RouteChanged)[-1]
    assert route.destination == net.stations["b"].mac
    assert route.next_hop is not None
    for relay in ("r1", "r2"):
        net.stations[relay].is_silent = True
    for _ in range(60):
        net.send("a", "b")
        net.run(0.05)
    assert net.told("a", RouteChanged)[-1].next_hop is None
    assert net.counts("a")["no_route"] > 0


@pytest.mark.parametrize("metric", ["quality", "etx", "ett"])
def test_every_metric_finds_a_way(make_mesh_net, metric: str) -> None:
    net = make_mesh_net(metric=Metric(metric))
    net.line("abcd", loss_ratio=0.1)
    assert net.run(10.0, until=net.all_known)
    for _ in range(50):
        net.send("a", "d", b"x")
        net.run(0.05)
    assert len(net.got("d")) >= 48


def test_a_broadcast_is_repeated_for_the_relays_where_asked(make_mesh_net) -> None:
    arrived = {}
    for tries in (1, 3):
        net = make_mesh_net(seed=4, broadcast_tries=tries)
        for name in "abc":
            net.add(name)
        for ends in ("ab", "bc"):
            net.radio(*ends)
        assert net.run(5.0, until=net.all_known)
        net.run(3.0)
        net.change("a", "b", loss_ratio=0.4)
        for number in range(50):
            net.send("a", b"\xff" * 6, bytes((number,)))
            net.run(0.2)
        arrived[tries] = len(net.got("c"))
    assert arrived[1] <= 36  # 60 % are expected
    assert arrived[3] >= 42  # 94 % are


def test_who_sends_much_is_seen_to_use_the_air(make_mesh_net) -> None:
    net = make_mesh_net(utilisation_weight=1.0)
    net.line("abc")
    assert net.run(5.0, until=net.all_known)
    net.every(0.004, lambda: net.send("a", "b", bytes(1400)), until_s=net.now + 8.0)
    net.run(8.0)
    told = {node.mac: node.utilisation_ratio for node in net.stations["c"].mesh.snapshot(now=net.now).nodes}
    assert 0.3 < told[net.stations["b"].mac] < 0.9  # what it hears of a counts: 2 ms of every 4
    edges = {(e.sender, e.receiver): e.quality for e in net.stations["c"].mesh.snapshot(now=net.now).edges}
    assert max(edges.values()) < 0.9


def test_the_numbers_of_frames_wrap(make_mesh_net) -> None:
    net = make_mesh_net()
    net.line("abc")
    assert net.run(5.0, until=net.all_known)
    for name in "abc":
        station = net.stations[name]
        station.mesh._forwarder._sequence = 2**32 - 5
        for link in station.mesh._links:
            link.next_sequence = 0xFFFA
    net.run(30.0)  # TCs count on over the wrap, too
    for number in range(40):
        net.send("a", "c", bytes((number,)))
        net.run(0.02)
    assert len(net.got("c")) == 40
    assert net.all_known()
    assert not net.told("b", LinkDown)
