"""Hosts' questions for nodes that are out of reach for a while."""

from __future__ import annotations

import struct

from wnet.core.arp import Arp
from wnet.core.topology import Node
from wnet.core.wire_control import NodeInfo

OWN, PEER, OTHER = (bytes((2, 0, 0, 0, 0, number)) for number in (1, 2, 3))
ASKED = bytes((10, 240, 0, 2))


def request(target: bytes) -> bytes:
    ends = struct.pack("!6s4s6s4s", OWN, bytes((10, 240, 0, 1)), bytes(6), target)
    return b"\xff" * 6 + OWN + b"\x08\x06" + struct.pack("!HHBBH", 1, 0x0800, 6, 4, 1) + ends


def node(mac: bytes) -> Node:
    found = Node(mac, 1)
    found.info = NodeInfo(0.0, (ASKED,), ())
    return found


def test_a_node_that_was_known_is_answered_for_while_it_is_away() -> None:
    arp = Arp(OWN)
    assert arp.read(request(ASKED), []) is None, "nobody was ever known to have it"
    answer = arp.read(request(ASKED), [node(PEER)])
    assert answer is not None
    assert answer[6:12] == PEER
    assert arp.read(request(ASKED), []) == answer
    moved = arp.read(request(ASKED), [node(OTHER)])
    assert moved is not None
    assert moved[6:12] == OTHER, "who has it now goes first"


def test_only_so_many_are_remembered() -> None:
    arp = Arp(OWN)
    for number in range(3000):
        address = struct.pack("!I", 0x0AF00000 + number)
        known = node(PEER)
        known.info = NodeInfo(0.0, (address,), ())
        arp.read(request(address), [known])
    assert len(arp.__dict__["_owners"]) == 1024
