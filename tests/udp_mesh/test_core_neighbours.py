"""Fixed neighbours: nothing is broadcast, everybody who belongs is reached, and who is not listed is answered."""

from __future__ import annotations

from typing import Any

import pytest

from udp_mesh.core import wire
from udp_mesh.core.airtime import airtime_s
from udp_mesh.core.events import PeerDown

KEY = bytes(range(32))


@pytest.fixture
def fixed(make_net: type[Any]) -> type[Any]:
    """A network class in which every node has a list of neighbours; addresses are names."""

    class Fixed(make_net):  # type: ignore[misc]
        def __init__(self, listed: dict[str, tuple[str, ...]], **link: float) -> None:
            super().__init__(**link)
            self.keep_datagrams = True
            self.listed = listed

        def add(self, name: str, **settings: object) -> Any:
            core = super().add(name, **settings)
            core.add_carrier(0, neighbours=self.listed[name])
            return core

        def broadcasts(self) -> list[Any]:
            return [d for sent in self.sent.values() for _at, d in sent if not d.path.address]

    return Fixed


EVERYBODY = {"a": ("b", "c"), "b": ("a", "c"), "c": ("a", "b")}


@pytest.mark.parametrize("keys", [(), (KEY,)], ids=["plain", "sealed"])
def test_everything_for_all_goes_to_each_neighbour_and_nothing_is_broadcast(
    fixed: type[Any], keys: tuple[bytes, ...]
) -> None:
    net = fixed(EVERYBODY, delay_s=0.005)
    for name in EVERYBODY:
        net.add(name, keys=keys)
    net.meet()
    net.publish("a", "t", b"small", to="all")
    net.publish("a", "t", bytes(5000), to="all")
    net.run(8.0)
    for name in "bc":
        assert [len(event.payload) for event in net.delivered(name)] == [5, 5000]
    assert net.broadcasts() == []
    assert not [event for name in EVERYBODY for event in net.of(name, PeerDown)]


def test_who_is_not_listed_is_answered_and_stays_known(fixed: type[Any]) -> None:
    net = fixed({"base": (), "robot": ("base",)}, delay_s=0.005)
    net.add("base")
    net.add("robot")
    net.meet()
    net.publish("base", "t", b"to all", to="all")
    net.run(30.0)
    assert [event.payload for event in net.delivered("robot")] == [b"to all"]
    assert net.of("robot", PeerDown) == net.of("base", PeerDown) == []
    assert net.broadcasts() == []


def test_after_an_outage_who_is_not_listed_finds_the_way_back(fixed: type[Any]) -> None:
    net = fixed({"base": (), "robot": ("base",)}, delay_s=0.005)
    net.add("base")
    net.add("robot")
    net.meet()
    for sender, receiver in (("robot", "base"), ("base", "robot")):
        net.publish(sender, "t", b"before", to=receiver)
    net.run(1.0)
    net.link("base", "robot", is_cut=True)
    net.publish("robot", "t", b"in the outage", to="base")
    net.publish("base", "t", b"in the outage", to="robot")
    net.run(15.0)
    assert net.of("robot", PeerDown)
    net.link("base", "robot", is_cut=False)
    net.run(0.1)
    for name in ("base", "robot"):
        assert [event.payload for event in net.delivered(name)] == [b"before", b"in the outage"]


def test_neighbours_that_are_absent_cost_no_more_than_the_share(fixed: type[Any]) -> None:
    absent = tuple(f"absent{n}" for n in range(30))
    net = fixed({"a": absent}, delay_s=0.005)
    core = net.add("a", channel_bps=1e6)
    net.run(20.0)
    net.sent["a"].clear()
    net.run(120.0)
    airtime = sum(airtime_s(len(d.data), channel_bps=1e6) for _at, d in net.sent["a"])
    assert len(net.sent["a"]) % len(absent) == 0
    assert 0 < airtime / 120 < 0.6 * core.settings.beacon_share


def test_who_asks_is_answered_by_unicast(fixed: type[Any]) -> None:
    net = fixed({"base": (), "robot": ("base",)}, delay_s=0.005)
    net.add("base")
    net.run(2.0)
    robot = net.add("robot")
    net.meet()
    first = next(packet for _at, packet in net.packets("base") if packet.beacons)
    assert first.destination_tag == wire.tag_of(robot.epoch)


def test_a_search_among_many_neighbours_keeps_to_its_share(fixed: type[Any]) -> None:
    absent = tuple(f"absent{n}" for n in range(29))
    net = fixed({"a": ("b", *absent), "b": ("a",)}, delay_s=0.005)
    for name in "ab":
        net.add(name, channel_bps=1e6)
    net.meet()
    net.publish("a", "t", b"x", to="b")
    net.run(1.0)
    net.link("a", "b", is_cut=True)
    net.publish("a", "t", b"x", to="b")
    net.run(5.0)
    net.sent["a"].clear()
    net.run(20.0)
    airtime = sum(airtime_s(len(d.data), channel_bps=1e6) for _at, d in net.sent["a"])
    assert 0.005 < airtime / 20 < 0.03  # 2 % for probes, half a percent for beacons


def test_a_message_for_all_without_anybody_to_send_it_to_ends(fixed: type[Any]) -> None:
    net = fixed({"a": ()}, delay_s=0.005)
    core = net.add("a")
    net.publish("a", "t", b"to nobody", to="all")
    net.run(1.0)
    assert core.stats()["queued_bytes"] == 0


def test_broadcasts_to_many_neighbours_keep_their_pace(fixed: type[Any]) -> None:
    """Ten neighbours get ten datagrams for each message, so they leave ten times as far apart."""
    net = fixed({"a": tuple(f"n{n}" for n in range(10))}, delay_s=0.005)
    net.add("a")
    net.run(2.0)
    net.sent["a"].clear()
    for _ in range(50):
        net.publish("a", "t", bytes(1200), to="all")
    net.run(0.5)
    sent_bits = sum(8 * len(d.data) for _at, d in net.sent["a"] if len(d.data) > 1000)
    assert 0.8 * 3e6 < sent_bits < 1.2 * 3e6  # half a second at 6 Mbit/s, which an unknown channel is given
