"""Daemons killed at random instants of an outage: nothing lost, nothing twice, nothing that was given up arrives."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests.udp_mesh.store_stations import TURN_S, SlowDisk, Station
from udp_mesh.client_fates import TrackedMessage
from udp_mesh.client_state import ClientState
from udp_mesh.core import envelope as envelopes
from udp_mesh.core.events import MessageDelivered, StoredDropped
from udp_mesh.local_fates import Outcome

TRIALS = int(os.environ.get("UDP_MESH_TRIALS", "10"))  # the benchmark asks for more


@pytest.fixture
def pair(make_net: Any, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[tuple[Any, Station, Station]]:
    seed = getattr(request, "param", 1)
    print(f"seed {seed}")
    net = make_net(seed=seed)
    stations = Station(net, "a", tmp_path), Station(net, "b", tmp_path, topics=("log",))
    for station in stations:
        station.start()
    net.meet()

    def turn() -> None:
        for station in stations:
            station.turn()

    net.every(TURN_S, turn, until_s=net.now + 1e6)
    net.run(0.2)
    yield net, *stations
    for station in stations:
        if station.durable is not None and station.durable._thread is not None:
            station.durable._thread.close()


def test_a_stored_message_is_confirmed_and_leaves_nothing_behind(pair: tuple[Any, Station, Station]) -> None:
    net, a, b = pair
    a.publish("log", b"one", "b", priority=3)
    a.publish("log", bytes(200_000), "b", priority=3)
    assert net.run(5.0, until=lambda: len(b.received) == 2)
    assert net.run(5.0, until=lambda: a.durable is not None and len(a.durable.custody) == 0)
    net.run(1.0)
    assert a.durable is not None
    assert b.durable is not None
    assert a.durable.stats()["stored_confirmed"] == 2
    assert (len(b.durable.inbox), len(a.state.stored.undecided)) == (0, 0)
    disk = a.durable._thread
    assert isinstance(disk, SlowDisk)
    assert disk.count("outgoing") == 0


def test_what_nobody_wants_yet_waits_for_a_subscriber(pair: tuple[Any, Station, Station]) -> None:
    net, a, b = pair
    a.publish("photo", b"picture", "b")
    net.run(2.0)
    assert b.received == []
    b.kill(Random(1))
    b.topics = ("log", "photo")
    b.start()
    assert net.run(5.0, until=lambda: b.received == [b"picture"])


def test_a_message_outlives_its_destinations_absence(pair: tuple[Any, Station, Station]) -> None:
    net, a, b = pair
    b.kill(Random(1))
    net.run(5.0)
    a.publish("log", b"for later", "b")
    net.run(1.0)
    a.kill(Random(2))
    a.start()
    net.run(1.0)
    b.start()
    assert net.run(10.0, until=lambda: b.received == [b"for later"])


@pytest.mark.parametrize("pair", range(TRIALS), indirect=True)
def test_killed_at_random_instants_of_an_outage_nothing_is_lost_or_twice(pair: tuple[Any, Station, Station]) -> None:
    net, a, b = pair
    rng = Random(net.rng.random())
    sent: list[bytes] = []
    tracked: list[TrackedMessage] = []

    def publish() -> None:
        sent.append(len(sent).to_bytes(4, "big") + bytes(rng.choice([0, 100, 5000])))
        tracked.append(a.publish("log", sent[-1], "b", priority=rng.choice([1, 5])))

    began_s = net.now
    net.every(0.05, publish, until_s=began_s + 3.0)
    net.at(began_s + 0.5, lambda: net.link("a", "b", is_cut=True))
    net.at(began_s + 2.0, lambda: net.link("a", "b", is_cut=False))
    for station in (a, b):
        at_s = began_s + rng.uniform(0.3, 2.6)
        net.at(at_s, lambda station=station: station.kill(rng))
        net.at(at_s + rng.uniform(0.01, 0.8), station.start)
    net.run(3.1)
    assert net.run(60.0, until=lambda: len(b.received) >= len(sent) and not a.state.stored.undecided)
    net.run(11.0)  # a repetition for want of a confirmation would show now
    assert sorted(b.received) == sorted(sent)
    assert a.durable is not None
    assert len(a.durable.custody) == len(a.durable.fates) == len(a.state.tracked) == 0
    fates = [message.fates["b"] for message in tracked]  # each has one
    told = Counter((fate.outcome, fate.reason) for fate in fates)
    assert set(told) <= {(Outcome.ACKNOWLEDGED, ""), (Outcome.UNKNOWN, "settled_unseen")}
    # Nobody heard of those that ended just before the kill, or between it and the new connection.
    assert told[Outcome.UNKNOWN, "settled_unseen"] <= 5, told


def test_a_repeated_message_is_confirmed_again_and_offered_to_nobody(pair: tuple[Any, Station, Station]) -> None:
    net, a, b = pair
    a.publish("log", b"once", "b")
    assert net.run(5.0, until=lambda: b.received == [b"once"])
    net.run(1.0)
    assert a.durable is not None
    assert b.durable is not None
    (delivered,) = [event for event in net.events["b"] if isinstance(event, MessageDelivered)]
    decoded = envelopes.decode(delivered.payload)
    assert decoded is not None
    b.state = ClientState()  # another application, which remembers nothing
    b._connect()
    b.durable.received(delivered, *decoded)
    net.run(1.0)
    assert b.received == [b"once"]
    assert b.durable.stats()["stored_duplicates"] == 1
    confirmed = [e for e in net.events["a"] if isinstance(e, MessageDelivered) and e.topic == "udp_mesh/confirm"]
    assert len(confirmed) == 2


@pytest.mark.parametrize("pair", range(3), indirect=True)
def test_what_had_to_make_room_never_arrives(pair: tuple[Any, Station, Station]) -> None:
    net, a, b = pair
    assert a.durable is not None
    a.durable.custody.limit_bytes = 65_536
    b.kill(Random(1))  # a does not know yet: part of what follows is with the transport when it has to make room
    for number in range(20):
        a.publish("log", bytes([number]) * 6000, "b", priority=5)
        net.run(0.03)
    dropped = [event.sequence for event in a.reported if isinstance(event, StoredDropped)]
    assert dropped == list(range(1, 11))
    b.start()
    net.run(30.0)
    assert sorted(payload[0] for payload in b.received) == list(range(10, 20))


def test_what_a_full_disk_could_not_remove_is_removed_later(pair: tuple[Any, Station, Station]) -> None:
    net, a, b = pair
    assert a.durable is not None
    assert b.durable is not None
    disks = [station.durable._thread for station in (a, b) if station.durable is not None]
    assert all(isinstance(disk, SlowDisk) for disk in disks)
    a.publish("log", b"one", "b")
    assert net.run(5.0, until=lambda: b.received == [b"one"])
    for disk in disks:
        disk.is_full = True  # type: ignore[union-attr]
    net.run(5.0)
    assert len(a.durable.custody) == 0
    assert a.publish("log", b"two", "b").fates == {}
    net.run(0.1)
    assert a.state.refusals == {"disk_full": 1}
    assert [disk.count("outgoing") for disk in disks] == [1, 0]  # type: ignore[union-attr]
    for disk in disks:
        disk.is_full = False  # type: ignore[union-attr]
    net.run(5.0)
    assert disks[0].count("outgoing") == 0  # type: ignore[union-attr]
    assert b.durable.inbox.taken == []
