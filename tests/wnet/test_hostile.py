"""What nobody wishes for: strangers, forgeries, replays, two nodes with one address, deaf links, clocks that stop."""

from __future__ import annotations

from itertools import pairwise
from random import Random

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from wnet.config import MeshConfig
from wnet.core import wire, wire_control
from wnet.core.events import DuplicateAddress, LinkDown, LinkDownReason, LinkUp
from wnet.core.links import MAX_LINKS
from wnet.core.mesh import Member, Mesh
from wnet.core.seal import SEAL_BYTES, Seal
from wnet.core.wire_control import Attributes, Heard, Hello, NodeInfo

KEY, OTHER_KEY = bytes(range(32)), bytes(32)
PEER, PEER_NODE = bytes((2, 9, 9, 9, 9, 1)), bytes((2, 9, 9, 9, 9, 2))
MEMBER, NODE = bytes((2, 8, 8, 8, 8, 1)), bytes((2, 8, 8, 8, 8, 2))
HEAD = wire.GROUP + PEER + wire.ETHERTYPE


def mesh(**config) -> Mesh:
    """One node with one radio at time 0."""
    return Mesh(MeshConfig(**config), NODE, [Member(MEMBER, True, 1700)], epoch=77, rng=Random(1), now=0.0)


def hello(number: int = 0, *, sequence: int = 1, lists: int | None = None) -> bytes:
    """A HELLO's body of neighbour ``number``; ``lists``: the epoch by which it lists this node."""
    heard = () if lists is None else (Heard(NODE, lists, 0, 0, 0, False, False, Attributes(0.0, None, None), None),)
    node = PEER_NODE[:4] + number.to_bytes(2, "big")
    return wire_control.encode_hello(Hello(node, 5, 0, sequence, 1.0, 0, 0.0, False, NodeInfo(), heard))


def two(make_mesh_net, **config):
    """Two nodes that know each other."""
    net = make_mesh_net(**config)
    for name in "ab":
        net.add(name)
    net.radio("a", "b")
    assert net.run(5.0, until=net.all_known)
    net.run(1.0)
    return net


@settings(max_examples=300, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=60)), max_size=12), st.booleans())
def test_no_frame_raises(bodies: list[tuple[int, bytes]], is_sealed: bool) -> None:
    node = mesh(key=(KEY,) if is_sealed else ())
    seal = Seal([KEY], epoch=3)
    node.receive(0, HEAD + hello(lists=77), now=0.0)
    for kind, rest in bodies:
        body = bytes((kind,)) + rest
        node.receive(0, HEAD + (seal.seal(HEAD, body) if is_sealed else body), now=0.1)
        node.receive(0, rest, now=0.1)
        node.receive(0, MEMBER + PEER + wire.ETHERTYPE + wire.aggregate([body, hello()]), now=0.1)
    node.handle_timer(now=0.2)
    node.frames_to_send(now=0.2)
    node.snapshot(now=0.2)


@given(st.binary(max_size=80))
def test_no_frame_of_the_host_raises(rest: bytes) -> None:
    node = mesh()
    for destination in (PEER, b"\xff" * 6, bytes.fromhex("01005e010101"), bytes.fromhex("333300000001"), b""):
        node.originate(destination + NODE + rest, now=0.0)
    node.frames_to_send(now=0.0)


def test_malformed_frames_are_counted_by_reason_and_dropped() -> None:
    node = mesh()
    node.receive(0, HEAD + hello(lists=77), now=0.0)
    for body, reason in (
        (b"", "too_short"),
        (b"\x00\x00", "version"),
        (bytes((wire.UNICAST,)), "too_short"),
        (bytes((wire.UNICAST,)) + bytes(60), "malformed"),
        (hello()[:8] + b"\x55" + hello()[9:], "check"),
        (wire.encode(wire.PROBE, b"", is_ack_wanted=True, attempt=0, hop_limit=1, urgency=0)[:-1] + b"\1", "check"),
    ):
        before = node.counts[reason]
        node.receive(0, HEAD + body, now=0.0)
        assert node.counts[reason] == before + 1, body
    node.receive(0, HEAD[:12] + b"\x08\x00" + bytes(50), now=0.0)
    assert node.counts["other_type"] == 1


def test_strangers_get_nothing_forwarded() -> None:
    node = mesh()
    tail = wire.tail_of(1, 1, NODE + PEER_NODE + b"\x08\x00" + bytes(30))
    body = wire.encode(wire.UNICAST, tail, is_ack_wanted=True, attempt=0, hop_limit=9, urgency=6, sequence=1)
    node.receive(0, MEMBER + HEAD[6:] + body, now=0.0)
    assert node.counts["stranger"] == 1
    assert node.take_delivered() == []


def test_a_flood_of_forged_hellos_finds_bounded_room_and_does_not_push_out_neighbours(make_mesh_net) -> None:
    net = two(make_mesh_net)
    control = net.counts("a")["control_bytes"]
    for number in range(3000):
        source = b"\x02\x66\x66\x66" + number.to_bytes(2, "big")
        net.stations["a"].mesh.receive(0, wire.GROUP + source + wire.ETHERTYPE + hello(number), now=net.now)
        if number % 300 == 0:
            net.run(0.1)
    net.run(1.0)
    state = net.stations["a"].mesh.snapshot(now=net.now)
    assert len(state.links) == MAX_LINKS
    assert [link.neighbour for link in state.links if link.is_usable] == [net.stations["b"].mac]
    net.send("a", "b", b"still here")
    net.run(0.1)
    assert net.got("b") == [b"still here"]
    spent = net.counts("a")["control_bytes"] - control
    assert 8 * spent / 2.0 < 0.1 * 6e6  # what the node answers stays within its budget and one burst


def test_with_a_key_a_flood_from_outside_the_team_changes_nothing(make_mesh_net) -> None:
    net = two(make_mesh_net, key=(KEY,))
    seal, before = Seal([OTHER_KEY], epoch=9), net.stations["a"].mesh.snapshot(now=net.now)
    for number in range(500):
        net.inject("a", 0, HEAD + hello(number))
        net.inject("a", 0, HEAD + seal.seal(HEAD, hello(number)))
    after = net.stations["a"].mesh.snapshot(now=net.now)
    assert (after.links, after.nodes, after.edges) == (before.links, before.nodes, before.edges)
    counts = net.counts("a")
    assert counts["unsealed"] == 500
    assert counts["unknown_key"] + counts["forged"] == 500


def test_a_sealed_frame_opens_once_and_for_its_own_addresses_only() -> None:
    sender, receiver = Seal([KEY], epoch=1), Seal([OTHER_KEY, KEY], epoch=2)
    sealed = sender.seal(HEAD, b"body")
    assert len(sealed) == len(b"body") + SEAL_BYTES
    assert receiver.open(HEAD[:11] + b"\x99" + HEAD[12:] + sealed) == "forged"
    assert receiver.open(HEAD + sealed[:-1]) == "forged"
    assert receiver.open(HEAD + sealed + bytes(20)) == b"body"  # Ethernet pads
    assert receiver.open(HEAD + sealed) == "replayed"
    assert Seal([bytes((1,) * 32)], epoch=2).open(HEAD + sealed) in ("unknown_key", "forged")
    assert sender.seal(HEAD, b"body") != sealed


def test_a_recording_of_yesterday_makes_no_neighbour(make_mesh_net) -> None:
    net = two(make_mesh_net, key=(KEY,))
    recorded = [outgoing.frame for _at, outgoing in net.stations["b"].sent]
    net.stations["b"].is_silent = True
    net.add("a")  # started again: another epoch
    for frame in recorded:
        net.inject("a", 0, frame)
        net.run(0.01)
    assert recorded
    state = net.stations["a"].mesh.snapshot(now=net.now)
    assert not any(link.is_usable for link in state.links)
    assert state.routes == ()


def test_a_team_with_a_key_carries_traffic_over_hops(make_mesh_net) -> None:
    net = make_mesh_net(key=(KEY,))
    net.line("abc")
    assert net.run(5.0, until=net.all_known)
    net.send("a", "c", b"secret")
    net.run(0.1)
    assert net.got("c") == [b"secret"]
    assert not any(b"secret" in outgoing.frame for _at, outgoing in net.stations["a"].sent)


def test_two_nodes_with_one_address_are_told_of(make_mesh_net) -> None:
    net = make_mesh_net()
    net.add("a", number=1)
    net.add("twin", number=1)
    net.stations["twin"].members[0] = Member(bytes((2, 7, 7, 7, 7, 7)), True, 1700)
    net.stations["twin"].mesh = Mesh(
        MeshConfig(), net.stations["a"].mac, net.stations["twin"].members, epoch=4242, rng=Random(3), now=net.now
    )
    net.add("m", number=3)
    net.radio("a", "twin")
    net.radio("a", "m")
    net.radio("twin", "m")
    net.run(5.0)
    for name in ("a", "twin"):
        conflicts = net.told(name, DuplicateAddress)
        assert conflicts
        assert {event.mac for event in conflicts} == {net.stations["a"].mac}
        assert len(conflicts) <= 6  # one a second
    assert net.told("m", DuplicateAddress)


def test_a_twin_out_of_earshot_is_noticed_on_the_way(make_mesh_net) -> None:
    net = make_mesh_net(tc_slow_s=2.0)
    for name, number in (("a", 1), ("m", 3), ("n", 4), ("twin", 1)):
        net.add(name, number=number)
    net.stations["twin"].members[0] = Member(bytes((2, 7, 7, 7, 7, 7)), True, 1700)
    net.stations["twin"].mesh = Mesh(
        MeshConfig(tc_slow_s=2.0),
        net.stations["a"].mac,
        net.stations["twin"].members,
        epoch=4242,
        rng=Random(3),
        now=net.now,
    )
    net.radio("a", "m")
    net.radio("m", "n")
    net.radio("n", "twin")
    net.run(15.0)
    conflicts = [event for name in net.stations for event in net.told(name, DuplicateAddress)]
    assert {event.mac for event in conflicts} == {net.stations["a"].mac}


def test_a_restart_is_no_conflict(make_mesh_net) -> None:
    net = make_mesh_net()
    net.line("abc")
    assert net.run(5.0, until=net.all_known)
    net.run(5.0)
    net.add("b")
    assert net.run(5.0, until=net.all_known)
    net.run(5.0)
    assert not any(net.told(name, DuplicateAddress) for name in "abc")
    net.send("a", "c", b"again")
    net.run(0.1)
    assert net.got("c") == [b"again"]


def test_a_link_in_one_direction_carries_nothing(make_mesh_net) -> None:
    net = make_mesh_net()
    for name in "abr":
        net.add(name)
    for a, b in ("ab", "ar", "rb"):
        net.radio(a, b)
    net.one_way("b", "a", is_cut=True)
    assert net.run(8.0, until=net.all_known)
    net.run(2.0)
    net.send("a", "b", b"around")
    net.run(0.1)
    assert net.got("b") == [b"around"]
    assert net.counts("r")["relayed"] == 1
    assert not any(
        link.is_usable
        for link in net.stations["a"].mesh.snapshot(now=net.now).links
        if link.neighbour == net.stations["b"].mac
    )


def test_a_link_that_becomes_deaf_in_one_direction_is_given_up(make_mesh_net) -> None:
    net = make_mesh_net()
    for name in "abr":
        net.add(name)
    for a, b in ("ab", "ar", "rb"):
        net.radio(a, b)
    assert net.run(5.0, until=net.all_known)
    net.run(2.0)
    net.one_way("a", "b", is_cut=True)
    net.every(0.05, lambda: net.send("a", "b", b"x"), until_s=net.now + 3.0)
    start = net.now
    net.run(3.2)
    downs = net.told("a", LinkDown)
    assert downs[0].reason is LinkDownReason.NOT_ACKNOWLEDGED
    times = [start, *net.times("b")]
    assert max(b - a for a, b in pairwise(times)) < 0.3
    later = [event for event in net.told("a", LinkUp) if event.now > downs[0].now]
    assert not later  # it is heard all the time and yet not used again


def test_a_clock_that_stops_neither_crashes_nor_floods(make_mesh_net) -> None:
    net = two(make_mesh_net)
    station = net.stations["a"]
    now, sent = net.now, 0
    for n in range(2000):
        station.mesh.handle_timer(now=now)
        station.mesh.originate(net.stations["b"].mac + station.mac + b"\x08\x00\x45\x00" + bytes(30), now=now)
        sent += sum(outgoing.urgency == 0 for outgoing in station.mesh.frames_to_send(now=now))
        station.mesh.receive(0, HEAD + hello(sequence=n), now=now)
        assert (station.mesh.next_timer() or 0.0) > now - 10.0
    assert sent < 20


def test_a_clock_that_jumps_back_is_borne(make_mesh_net) -> None:
    net = two(make_mesh_net)
    mesh = net.stations["a"].mesh
    for now in (net.now - 50.0, net.now + 1e6, net.now):
        mesh.handle_timer(now=now)
        mesh.frames_to_send(now=now)
        mesh.snapshot(now=now)


def test_frames_of_a_bridged_host_are_refused_with_the_reason() -> None:
    node = mesh()
    node.originate(PEER + b"\2\2\2\2\2\2" + b"\x08\x00" + bytes(40), now=0.0)
    node.originate(b"", now=0.0)
    assert (node.counts["foreign_source"], node.counts["too_short"]) == (1, 1)
