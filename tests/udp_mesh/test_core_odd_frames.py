"""Odd frames built field by field: each is counted by its reason, and nothing else changes."""

from __future__ import annotations

from typing import Any

import pytest
from scapy.packet import Packet

from netlab.scapy_layers.udp_mesh import Ack, AckRange, Data, UdpMesh
from tests.scapy_layers.odd_frames import ODD, odd_datagram
from udp_mesh.core import wire
from udp_mesh.core.mesh import MeshCore, Path


def state_of(core: MeshCore, now: float) -> object:
    """Whatever a datagram could change, counters excepted."""
    return core.peers(now=now), core.queue_depths(), core.stats()["reassembly_bytes"], core.stats()["queued_bytes"]


@pytest.mark.parametrize("name", ODD)
def test_an_odd_datagram_is_counted_by_its_reason_and_changes_nothing(make_net: Any, name: str) -> None:
    net = make_net()
    net.add("a")
    core = net.add("b")
    net.meet()
    data, reason = odd_datagram(name, epoch=net.cores["a"].epoch, tag=wire.tag_of(core.epoch), number=1000)
    counters, state = core.stats(), state_of(core, net.now)
    core.receive_datagram(data, Path(0, "a"), now=net.now)
    assert state_of(core, net.now) == state
    changed = {key: value - counters.get(key, 0) for key, value in core.stats().items() if value != counters.get(key)}
    assert changed == {f"bad_{reason}": 1, "datagrams_received": 1}
    assert core.datagrams_to_send(now=net.now) == []
    net.publish("a", "t", b"afterwards", "b")
    net.run(1.0)
    assert [event.payload for event in net.delivered("b")] == [b"afterwards"]


#: Frames that can be read, but not be true.
UNTRUE: dict[str, tuple[list[Packet], str]] = {
    "acknowledged what was never sent": ([Ack(largest=1 << 40)], "acks_of_unsent"),
    "ranges that touch and repeat": (
        [Ack(largest=1 << 40, first_range=0xFFFF, ranges=[AckRange(gap=0, length=0xFFFF)] * 255)],
        "acks_of_unsent",
    ),
    "fragments of one message that contradict": (
        [Data(message_id=90, index=1, count=3, data=b"xx"), Data(message_id=90, index=2, count=4, data=b"x")],
        "fragments_contradiction",
    ),
    "a priority that changes": (
        [
            Data(message_id=91, index=1, count=3, data=b"xx"),
            Data(message_id=91, index=0, count=3, topic=b"t", priority=1),
        ],
        "fragments_contradiction",
    ),
}


@pytest.mark.parametrize("name", UNTRUE)
def test_a_datagram_that_cannot_be_true_is_counted_and_breaks_nothing(make_net: Any, name: str) -> None:
    net = make_net()
    net.add("a")
    core = net.add("b")
    net.meet()
    frames, counter = UNTRUE[name]
    header = {"epoch": net.cores["a"].epoch, "destination_tag": wire.tag_of(core.epoch), "packet_number": 1000}
    core.receive_datagram(bytes(UdpMesh(frames=frames, **header)), Path(0, "a"), now=net.now)
    assert core.stats()[counter] == 1
    assert net.delivered("b") == []
    net.publish("b", "t", bytes(5000), "a")
    net.run(1.0)
    assert len(net.delivered("a")) == 1
