"""The goals of a mesh, over twenty seeds each, in virtual time: reroute, reconnect, multicast, the cost of control."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from random import Random

import pytest

from wnet.core import wire

SEEDS = range(20)
GOAL_S = 0.3
PING_S = 0.05
CHANNEL_SHARE = 0.02
CONTROL = frozenset((wire.HELLO, wire.TC, wire.PROBE, wire.ACK))


def p90(values: Iterable[float]) -> float:
    """The ninth decile, the higher of two neighbours."""
    row = sorted(values)
    return row[math.ceil(0.9 * len(row)) - 1]


def airtime_s(frame: bytes) -> float:
    """Time of a group frame on an OFDM radio at 6 Mbit/s, preamble included (IEEE 802.11-2016, 17.4.3)."""
    psdu_bytes = len(frame) - 14 + 24 + 8 + 4
    return (20 + 4 * math.ceil((22 + 8 * psdu_bytes) / 24)) * 1e-6


def ping(net, a: str, b: str) -> None:
    """Send in both directions at 20 Hz until the end."""
    for source, destination in ((a, b), (b, a)):
        net.every(PING_S, lambda s=source, d=destination: net.send(s, d), until_s=net.now + 60.0)


def outage_s(net, names: str, since_s: float) -> float:
    """The longest pause between deliveries from shortly before ``since_s`` on, at any of some nodes."""
    found = []
    for name in names:
        times = [at for at in net.times(name) if at >= since_s - 2 * PING_S] + [net.now]
        found.append(max(later - earlier for earlier, later in pairwise(times)))
    return max(found)


def diamond(make_mesh_net, seed: int, **path):
    """The lab's relay_diamond: two relays between a and b, a third behind the second."""
    net = make_mesh_net(seed=seed)
    for name, wires in (("a", 3), ("b", 2), ("r1", 2), ("r2", 3), ("r3", 2)):
        net.add(name, radios=0, wires=wires)
    for ends in (("a", "r1"), ("r1", "b"), ("a", "r2"), ("r2", "b"), ("a", "r3"), ("r3", "r2")):
        net.wire(*ends, delay_s=0.002, **path)
    assert net.run(10.0, until=net.all_known)
    net.run(5.0 + 5.0 * net.rng.random())
    ping(net, "a", "b")
    net.run(2.0 + net.rng.random())
    return net


def relay_of(net, source: str, destination: str) -> str:
    """Who carries at the moment."""
    target = net.stations[destination].mac
    route = next(r for r in net.stations[source].mesh.snapshot(now=net.now).routes if r.destination == target)
    return next(station.name for station in net.stations.values() if station.mac == route.next_hop)


def reroute_s(make_mesh_net, seed: int, cut: str, loss_ratio: float = 0.0) -> float:
    """How long traffic pauses when its relay is lost without a word. ``cut``: "relay", or the end of its link."""
    net = diamond(make_mesh_net, seed, loss_ratio=loss_ratio)
    relay, since_s = relay_of(net, "a", "b"), net.now
    if cut == "relay":
        net.stations[relay].is_silent = True
    else:
        net.change(relay, cut, is_cut=True)
    net.run(1.5)
    return outage_s(net, "ab", since_s)


def reconnect_s(make_mesh_net, seed: int) -> float:
    """How long after 15 s without any link the first frame of three hops arrives, in the slower direction."""
    net = make_mesh_net(seed=seed)
    net.line("abcd", delay_s=0.002)
    assert net.run(10.0, until=net.all_known)
    net.run(5.0 + 5.0 * net.rng.random())
    ping(net, "a", "d")
    net.run(2.0 + net.rng.random())
    for ends in ("ab", "bc", "cd"):
        net.change(*ends, is_cut=True)
    net.run(15.0)
    for ends in ("ab", "bc", "cd"):
        net.change(*ends, is_cut=False)
    restored_s = net.now
    net.run(1.5)
    return resumed_s(net, "ad", restored_s)


def resumed_s(net, names: Iterable[str], restored_s: float) -> float:
    """How long after a moment all of some nodes have got a frame."""
    first = [min([at for at in net.times(name) if at > restored_s], default=net.now) for name in names]
    return max(first) - restored_s


@pytest.mark.parametrize("cut", ["relay", "a", "b"])
@pytest.mark.parametrize("loss_ratio", [0.0, 0.05])
def test_traffic_flows_again_within_300_ms_of_a_silent_loss(make_mesh_net, cut: str, loss_ratio: float) -> None:
    outages = [reroute_s(make_mesh_net, seed, cut, loss_ratio) for seed in SEEDS]
    assert p90(outages) <= GOAL_S, sorted(outages)


def test_three_hops_carry_again_within_300_ms_of_the_end_of_an_outage(make_mesh_net) -> None:
    delays = [reconnect_s(make_mesh_net, seed) for seed in SEEDS]
    assert p90(delays) <= GOAL_S, sorted(delays)


def join(net, name: str, group: bytes) -> None:
    """Let a node's host report a group (IGMPv2)."""
    ip = bytes((0x45, 0)) + bytes(7) + b"\x02" + bytes(10)
    mac = b"\x01\x00\x5e" + group[1:]
    report = mac + net.stations[name].mac + b"\x08\x00" + ip + b"\x16\0\0\0" + group
    net.stations[name].mesh.originate(report, now=net.now)


def test_the_other_relay_carries_soon_after_the_tenth_outage_as_after_the_first(make_mesh_net) -> None:
    """Searching for 15 s and more, time and again, spends more than control may in the long run. What it finds has to
    be told at once all the same."""
    net = diamond(make_mesh_net, 1)
    for number, name in enumerate(net.stations):
        net.stations[name].mesh.set_addresses([bytes((10, 9, 0, number + 1))], now=net.now)
        for group in range(3):
            group_ip = bytes((239, 1, number, group))
            net.every(30.0, lambda name=name, group_ip=group_ip: join(net, name, group_ip), until_s=net.now + 300.0)
    for source, destination in ("ab", "ba"):  # goes on where ping ends
        net.every(PING_S, lambda s=source, d=destination: net.send(s, d), until_s=net.now + 300.0)
    delays = []
    for _ in range(10):
        old = relay_of(net, "a", "b")
        pairs = {tuple(sorted((x[0], y[0]))) for x, y in net.paths}
        for ends in pairs:
            net.change(*ends, is_cut=True)
        net.run(15.0)
        for ends in pairs:
            net.change(*ends, is_cut=old in ends)
        restored_s = net.now
        net.run(4.0)
        delays.append(resumed_s(net, "ab", restored_s))
        for ends in pairs:
            net.change(*ends, is_cut=False)
        net.run(6.0 + net.rng.random())
    assert p90(delays) <= GOAL_S, delays


def places(seed: int) -> list[tuple[str, tuple[float, float]]]:
    """Where twenty nodes are on a unit square."""
    rng = Random(seed)
    return [(f"n{i:02}", (rng.random(), rng.random())) for i in range(20)]


def scattered(make_mesh_net, seed: int, reach: float):
    """Twenty nodes that hear each other up to ``reach``."""
    net, nodes = make_mesh_net(seed=seed), places(seed)
    for name, _place in nodes:
        net.add(name)
    for i, (name, place) in enumerate(nodes):
        for other, its_place in nodes[:i]:
            if math.dist(place, its_place) <= reach:
                net.radio(name, other, snr_db=20.0)
    return net


def settled_share(make_mesh_net, reach: float) -> float:
    """The part of the channel's time that twenty settled nodes spend, all they send added up."""
    net = scattered(make_mesh_net, 3, reach)
    net.run(10.0)
    for station in net.stations.values():
        station.sent.clear()
    net.run(20.0)
    frames = [o.frame for station in net.stations.values() for _at, o in station.sent]
    assert frames
    assert all(frame[14] in CONTROL for frame in frames)
    return sum(map(airtime_s, frames)) / 20.0


@pytest.mark.parametrize("reach", [0.35, 2.0], ids=["over hops", "all in reach"])
def test_twenty_nodes_spend_little_of_their_channel_on_control(make_mesh_net, reach: float) -> None:
    assert settled_share(make_mesh_net, reach) <= CHANNEL_SHARE


def test_links_that_come_and_go_do_not_make_control_exceed_its_share(make_mesh_net) -> None:
    net = scattered(make_mesh_net, 3, 0.45)
    pairs = sorted({tuple(sorted((a[0], b[0]))) for a, b in net.paths})

    def change() -> None:
        net.change(*net.rng.choice(pairs), is_cut=net.rng.random() < 0.3)

    net.every(0.5, change, until_s=net.now + 100.0)
    net.run(20.0)  # what was saved for a burst is spent
    for station in net.stations.values():
        station.sent.clear()
    net.run(20.0)
    airtimes = [airtime_s(o.frame) for s in net.stations.values() for _at, o in s.sent if o.frame[14] != wire.ACK]
    assert sum(airtimes) / 20.0 <= CHANNEL_SHARE


def test_the_papers_multicast_reaches_all_over_lossy_links(make_mesh_net) -> None:
    """One source, three receivers behind relays, 1000-byte packets; 10 % of the frames of every link are lost."""
    net = make_mesh_net(seed=5)
    for name in ("s", "m1", "m2", "x", "y", "z"):
        net.add(name)
    for ends in (("s", "m1"), ("s", "m2"), ("m1", "x"), ("m1", "y"), ("m2", "z"), ("m2", "y")):
        net.radio(*ends, loss_ratio=0.1, snr_db=25.0)
    assert net.run(10.0, until=net.all_known)
    net.run(5.0)
    group = bytes.fromhex("01005e010101")
    for name in "xyz":
        ip = bytes((0x45, 0)) + bytes(7) + b"\x02" + bytes(10)
        report = group + net.stations[name].mac + b"\x08\x00" + ip + b"\x16\0\0\0\xef\1\1\1"
        net.stations[name].mesh.originate(report, now=net.now)
    net.run(2.0)
    for number in range(400):
        net.send("s", group, number.to_bytes(4, "big") + bytes(968))
        net.run(0.02)
    net.run(1.0)
    for name in "xyz":
        got = net.got(name)
        assert len(got) == len(set(got))
        assert len(got) >= 0.99 * 400, (name, len(got))
