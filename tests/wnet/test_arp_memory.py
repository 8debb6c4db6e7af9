"""Hosts' questions for nodes that are out of reach for a while."""

from __future__ import annotations

import struct

from wnet.config import MeshConfig
from wnet.core.topology import TopologyGraph
from wnet.core.wire_control import NodeInfo

MINE, THEIRS = bytes((10, 240, 0, 1)), bytes((10, 240, 0, 3))


def request(own_mac: bytes, target: bytes) -> bytes:
    ends = struct.pack("!6s4s6s4s", own_mac, MINE, bytes(6), target)
    return b"\xff" * 6 + own_mac + b"\x08\x06" + struct.pack("!HHBBH", 1, 0x0800, 6, 4, 1) + ends


def answered_by(net, name: str, target: bytes) -> bytes | None:
    """Who has the address, by what the mesh itself answers the host at once; None if it does not know."""
    station = net.stations[name]
    station.mesh.originate(request(station.mac, target), now=net.now)
    answers = [frame for frame in station.mesh.take_delivered() if frame[12:14] == b"\x08\x06"]
    return answers[0][6:12] if answers else None


def test_a_node_that_has_been_away_for_long_is_answered_for_though_nobody_had_asked_before(make_mesh_net) -> None:
    """Else the host, which asks once a second, would wait up to that long when the node is back."""
    net = make_mesh_net()
    for name in "abc":
        net.add(name)
    net.radio("a", "b")
    net.radio("b", "c")
    net.stations["c"].mesh.set_addresses([THEIRS], now=net.now)
    assert answered_by(net, "a", THEIRS) is None
    assert net.run(5.0, until=net.all_known)
    net.run(5.0)
    net.change("b", "c", is_cut=True)
    net.run(200.0)
    assert net.stations["c"].mac not in {node.mac for node in net.stations["a"].mesh.snapshot(now=net.now).nodes}
    assert answered_by(net, "a", THEIRS) == net.stations["c"].mac


def test_who_told_it_last_has_it_and_only_so_many_are_remembered() -> None:
    graph = TopologyGraph(bytes(6), MeshConfig(), epoch=1)
    for number in range(6000):
        mac = struct.pack("!HI", 2, number % 2)
        info = NodeInfo(0.0, (struct.pack("!I", number // 2),), ())
        graph.update_neighbour(mac, 1, info, None, hold_s=1e9, now=0.0)
    assert set(graph.owners.values()) == {struct.pack("!HI", 2, 1)}
    for number in range(6000):
        graph.update_neighbour(mac, 1, NodeInfo(0.0, (struct.pack("!I", number),), ()), None, hold_s=1e9, now=0.0)
    assert len(graph.owners) == 4096
