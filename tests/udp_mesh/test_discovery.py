"""Discovery in large teams: what it costs, how fast it is, and what is left unsaid where it is known already."""

from __future__ import annotations

import statistics
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from udp_mesh.core import wire
from udp_mesh.core.airtime import airtime_s
from udp_mesh.core.beacons import ANYBODY
from udp_mesh.core.events import PeerDown, PeerUp

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))
from discovery_rig import Channel, join_delays_s


@pytest.mark.parametrize("loss_ratio", [0.0, 0.2])
def test_a_newcomer_is_listed_within_a_second_and_all_keep_to_their_share(loss_ratio: float) -> None:
    channel = Channel(seed=3, loss_ratio=loss_ratio)
    for number in range(24):
        channel.add(f"n{number:02}")
    channel.run(channel.now + 4.0)
    assert all(core.is_online(name) for own, core in channel.cores.items() for name in channel.cores if name != own)
    channel.airtime_s, began_s = 0.0, channel.now
    delays = join_delays_s(channel, "newcomer", within_s=2.0)
    assert delays[int(0.95 * len(delays))] <= 1.0
    assert sum(channel.knows("newcomer", name) for name in channel.cores) >= 23
    channel.run(began_s + 12.0)
    assert channel.airtime_s / 12.0 <= 0.01


def beacon_times(net: Any, name: str) -> list[float]:
    return [at for at, packet in net.packets(name) if packet.is_broadcast and packet.beacons]


def test_the_interval_grows_with_the_team_and_slower_channels_and_is_announced(make_net: Any) -> None:
    def interval_s(nodes: int, **settings: object) -> float:
        net = make_net(seed=4)
        net.keep_datagrams = True
        for number in range(nodes):
            net.add(f"n{number:02}", **settings)
        net.run(200.0)
        announced = {p.beacons[0].beacon_interval_s for at, p in net.packets("n00") if p.beacons and at > 120.0}
        gaps = [b - a for a, b in pairwise(at for at in beacon_times(net, "n00") if at > 120.0)]
        assert statistics.mean(gaps) == pytest.approx(announced.pop(), rel=0.1)
        assert not announced
        return statistics.mean(gaps)

    assert interval_s(3) == pytest.approx(1.0, abs=0.1)
    slow = interval_s(3, channel_bps=200e3)
    own_s = airtime_s(22 + wire.HELLO_BYTES + 3, channel_bps=200e3)
    assert 3 * own_s / slow == pytest.approx(0.005, rel=0.1)
    assert interval_s(3, channel_bps=200e3, beacon_share=0.02) == pytest.approx(slow / 2, rel=0.1)


def test_a_node_that_starts_says_so_several_times_and_then_rarely(make_net: Any) -> None:
    net = make_net(seed=5)
    net.keep_datagrams = True
    net.add("b")
    net.add("a")
    net.run(5.0)
    times = [at - 100.0 for at in beacon_times(net, "a")]
    assert times[:4] == pytest.approx([0.0, 0.1, 0.3, 0.7], rel=0.15)
    asks = [at - 100.0 for at, packet in net.packets("a") if ANYBODY in packet.probes]
    assert asks == times[:4]
    assert min(b - a for a, b in pairwise(times[3:])) > 0.85


def test_a_node_that_has_nobody_is_heard_soon_and_promises_no_more_than_in_company(make_net: Any) -> None:
    net = make_net(seed=5)
    net.keep_datagrams = True
    net.add("a")
    net.run(5.0)
    beacons = [(at, packet.beacons[0]) for at, packet in net.packets("a") if packet.beacons and at > 101.0]
    gaps = [later[0] - earlier[0] for earlier, later in pairwise(beacons)]
    assert statistics.mean(gaps) == pytest.approx(0.25, abs=0.02)
    assert {beacon.beacon_interval_s for _at, beacon in beacons} == {1.0}
    net.add("b")
    net.run(10.0)
    settled = [at for at in beacon_times(net, "a") if at > net.now - 8.0]
    assert min(b - a for a, b in pairwise(settled)) > 0.85
    assert not net.of("b", PeerDown)
    net.link("a", "b", is_cut=True)
    net.run(10.0)
    assert len([at for at in beacon_times(net, "a") if at > net.now - 4.0]) >= 14


def test_who_is_listed_as_heard_does_not_answer(make_net: Any) -> None:
    net = make_net(seed=6)
    net.keep_datagrams = True
    for number in range(8):
        net.add(f"n{number}")
    net.run(3.2)
    net.add("late")
    began_s = net.now
    net.run(0.09)
    answers = [p for n in range(8) for at, p in net.packets(f"n{n}") if at > began_s and p.is_broadcast]
    assert 6 <= len(answers) <= 9, "each answers once"
    net.run(0.7)  # three more of its beacons, which list them all
    later = [p for n in range(8) for at, p in net.packets(f"n{n}") if at > began_s + 0.09 and p.is_broadcast]
    assert not any(wire.tag_of(net.cores["late"].epoch) in p.beacons[0].heard for p in later)


def test_beacons_are_left_out_where_traffic_proves_liveness_but_not_for_long(make_net: Any) -> None:
    net = make_net(seed=7)
    net.keep_datagrams = True
    for name in ("a", "b"):
        net.add(name)
    net.meet()
    net.run(2.0)
    net.every(0.1, lambda: net.publish("a", "t", bytes(50), "b"), until_s=net.now + 60)
    began_s = net.now
    net.run(60.0)
    times = [at for at in beacon_times(net, "a") if at > began_s + 1]
    assert 15 <= len(times) <= 22
    assert max(b - a for a, b in pairwise(times)) < 3.4
    assert all(len(net.of(name, PeerUp)) == 1 for name in ("a", "b"))


def test_data_for_a_peer_that_missed_our_beacons_is_understood_at_once(make_net: Any) -> None:
    net = make_net(seed=8)
    for number in range(6):
        net.add(f"n{number}")
    net.run(3.0)
    for number in range(6):
        net.links.setdefault((f"n{number}", "late"), type(next(iter(net.links.values())))(loss_ratio=1.0))
    net.add("late")
    net.run(0.05)
    assert net.cores["n3"].is_online("late")
    assert not net.cores["late"].is_online("n3")
    net.one_way("n3", "late", loss_ratio=0.0)
    net.publish("n3", "t", b"hello", "late")
    published_s = net.now
    net.run(0.1)
    (message,) = net.delivered("late")
    assert message.now - published_s < 0.012


def test_probes_keep_to_their_share_of_a_slow_channel_and_to_each_others_company(make_net: Any) -> None:
    def probes_per_s(searchers: int, **settings: object) -> list[float]:
        net = make_net(seed=9)
        net.keep_datagrams = True
        names = [f"n{number}" for number in range(searchers)]
        for name in (*names, "lost"):
            net.add(name, **settings)
        net.meet(60.0)
        net.stop("lost")
        for name in names:
            net.publish(name, "t", b"x", "lost")
        net.run(10.0)
        began_s = net.now
        net.run(20.0)
        return [sum(bool(p.probes) for at, p in net.packets(name) if at > began_s) / 20 for name in names]

    assert probes_per_s(1) == pytest.approx([40], rel=0.03)
    (slow,) = probes_per_s(1, channel_bps=100e3)
    assert slow * airtime_s(22 + wire.HELLO_BYTES + 2 + 6, channel_bps=100e3) == pytest.approx(0.02, rel=0.05)
    assert sum(probes_per_s(5)) == pytest.approx(40, rel=0.25)
