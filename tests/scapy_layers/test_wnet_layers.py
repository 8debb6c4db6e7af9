"""The scapy layers speak the same bytes as wnet's core."""

from __future__ import annotations

import pytest
from scapy.layers.l2 import Ether
from scapy.packet import Packet, Raw

from netlab.scapy_layers.wnet import (
    FLOOD,
    MULTICAST,
    PROBE,
    ROUTED,
    TC,
    UNICAST,
    Ack,
    Aggregate,
    Data,
    Heard,
    Hello,
    Hop,
    Relay,
    Sealed,
    Shared,
    body,
)
from wnet.core import wire, wire_control
from wnet.core.seal import Seal
from wnet.core.wire_control import Attributes, NodeInfo

A, B, C = (bytes.fromhex(f"02574e00000{number}") for number in (1, 2, 3))
INNER = Ether(src=A.hex(":"), dst=B.hex(":"), type=0x0800) / Raw(bytes(30))
TAIL = wire.tail_of(0x11223344, 7, bytes(INNER))
TOPOLOGY = wire_control.encode_tc(wire_control.Topology(A, 5.0, NodeInfo(), ()))
HEAD = {"ack_wanted": 1, "attempt": 2, "hop_limit": 9, "urgency": 3, "link_sequence": 4}
ORIGIN = {"epoch": 0x11223344, "sequence": 7}


def encoded(kind: int, tail: bytes = TAIL, listing: bytes = b"") -> bytes:
    options = {"is_ack_wanted": True, "attempt": 2, "hop_limit": 9, "urgency": 3, "sequence": 4}
    return wire.encode(kind, tail, listing=listing, **options)


MULTICAST_HOPS = [wire.Hop(B, 5, (B, C)), wire.Hop(C, 6, ())]
RELAYS = [hop._replace(destinations=()) for hop in MULTICAST_HOPS]
LINK = wire_control.Heard(B, 0x66, 1, 2, 3, True, False, Attributes(0.2, 30.0, None), None)
PAIRS: dict[str, tuple[Packet, bytes]] = {
    "unicast": (Data(kind=UNICAST, **HEAD, **ORIGIN) / INNER, encoded(wire.UNICAST)),
    "probe": (Data(kind=PROBE, **HEAD), encoded(wire.PROBE, b"")),
    "multicast": (
        Data(
            kind=MULTICAST, **HEAD, **ORIGIN,
            hops=[Hop(member=B.hex(":"), link_sequence=5, destinations=[B.hex(":"), C.hex(":")]),
                  Hop(member=C.hex(":"), link_sequence=6)],
        ) / INNER,
        encoded(wire.MULTICAST, listing=wire.forward_list(MULTICAST_HOPS)),
    ),
    "routed": (
        Data(kind=ROUTED, **HEAD, **ORIGIN, route=[B.hex(":"), C.hex(":")]) / INNER,
        encoded(wire.ROUTED, listing=wire.route_list([B, C])),
    ),
    "flood": (
        Data(
            kind=FLOOD, **HEAD, **ORIGIN,
            relays=[Relay(member=B.hex(":"), link_sequence=5), Relay(member=C.hex(":"), link_sequence=6)],
        ) / INNER,
        encoded(wire.FLOOD, listing=wire.relay_list(RELAYS)),
    ),
    "tc": (
        Data(kind=TC, **HEAD, **ORIGIN) / Raw(TOPOLOGY),
        encoded(wire.TC, wire.tail_of(0x11223344, 7, TOPOLOGY), wire.relay_list([])),
    ),
    "ack": (Ack(newest=9, attempt=1, bits=5), wire_control.encode_ack(wire_control.Ack(9, 1, 5))),
    "hello": (
        Hello(
            flags="partial", member=2, own_utilisation=51, utilisation=102, node=A.hex(":"), epoch=0x55, sequence=77,
            interval_ms=1500, digest=0xABCD, addresses=["10.0.0.1"], groups=[B.hex(":")],
            links=[
                Heard(node=B.hex(":"), epoch=0x66, peer_member=1, own_member=2, usable=1, link_id=3, loss=51, snr_db=30)
            ],
        ),
        wire_control.encode_hello(
            wire_control.Hello(
                A, 0x55, 2, 77, 1.5, 0xABCD, 0.2, True, NodeInfo(0.4, (b"\x0a\0\0\1",), (B,)), (LINK,)
            )
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PAIRS)
def test_a_body_is_built_and_dissected_as_the_core_does(name: str) -> None:
    packet, core = PAIRS[name]
    assert bytes(packet) == core
    whole = body(core + bytes(9))  # padded, as short Ethernet frames are
    assert type(whole) is type(packet)
    assert bytes(whole)[: len(core)] == core
    if name in ("unicast", "multicast", "routed", "flood"):
        assert whole[Ether].original == bytes(INNER)


def test_there_is_a_layer_for_every_kind() -> None:
    assert {kind for kind in wire.KINDS if isinstance(body(bytes([kind]) + bytes(60)), Raw)} == set()


def test_bodies_that_share_a_frame_are_taken_apart() -> None:
    bodies = [PAIRS["ack"][1], PAIRS["unicast"][1]]
    built = Aggregate(parts=[Shared(body=each) for each in bodies])
    assert bytes(built) == wire.aggregate(bodies)
    whole = body(bytes(built) + bytes(9))
    assert [part.body for part in whole.parts] == bodies
    assert [type(body(part.body)) for part in whole.parts] == [Ack, Data]
    assert wire.split(bytes(Aggregate(parts=[Shared(length=90, body=bodies[0])]))) is wire.Drop.MALFORMED


def test_a_sealed_body_tells_who_sealed_it() -> None:
    pytest.importorskip("cryptography")
    sealed = Seal([bytes(32)], epoch=0x99).seal(B + A + wire.ETHERTYPE, PAIRS["ack"][1])
    whole = body(sealed + bytes(9))
    assert isinstance(whole, Sealed)
    assert (whole.key_id, whole.counter, whole.epoch, whole.encrypted) == (sealed[1], 1, 0x99, sealed[14:])
    told = {"key_id": sealed[1], "counter": 1, "epoch": 0x99, "encrypted": sealed[14:]}
    assert bytes(Sealed(**told)) == sealed


def test_lengths_and_checks_can_lie() -> None:
    lies = bytes(Data(length=9000, check=1) / INNER)
    assert wire.decode(lies) is wire.Drop.MALFORMED
    assert wire.decode(bytes(Data(check=1) / INNER)) is wire.Drop.CHECK
    assert wire_control.decode_hello(bytes(Hello(link_count=9))) is wire.Drop.MALFORMED
    assert wire_control.decode_ack(bytes(Ack(check=1))) is wire.Drop.CHECK
