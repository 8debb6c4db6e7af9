"""wnet's frames as tshark tells them, against wnet's own encoders and decoders."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.packet import Packet

from netlab.capture.pcapng import INBOUND, OUTBOUND
from netlab.scapy_layers.udp_mesh import Hello
from tests.wireshark.tshark_rig import Row, Tape, Tshark, datagram
from wnet.core import wire, wire_control
from wnet.core.events import Drop
from wnet.core.seal import Seal
from wnet.core.wire_control import Attributes, Heard, Incoming, NodeInfo, Topology

A, B, C = (bytes.fromhex(f"02574e00000{number}") for number in (1, 2, 3))
MEMBER_A, MEMBER_B = bytes.fromhex("020000000001"), bytes.fromhex("020000000002")
INNER = bytes(
    Ether(src=A.hex(":"), dst=B.hex(":"))
    / IP(src="10.0.0.1", dst="10.0.0.2")
    / UDP(sport=8700, dport=8700)
    / datagram("base", "", 0, Hello(node=b"base"))
)
TAIL = wire.tail_of(0x11223344, 7, INNER)
HOPS = [wire.Hop(MEMBER_B, 5, (B, C)), wire.Hop(MEMBER_A, 9, ())]
TC = wire_control.encode_tc(
    Topology(A, 5.0, NodeInfo(0.5, (b"\x0a\0\0\1",), (B,)), (Incoming(B, 3, Attributes(0.2, 20.0, 6_000_000)),))
)
HELLO = wire_control.encode_hello(
    wire_control.Hello(
        A, 0x55, 2, 77, 1.5, 0xABCD, 0.25, True, NodeInfo(0.5, (b"\x0a\0\0\1", b"\x0a\0\0\2"), (B,)),
        (
            Heard(B, 0x66, 1, 2, 3, True, False, Attributes(0.0, 30.0, 54_000_000), Attributes(0.4, None, None)),
            Heard(C, 0x67, 0, 0, 0, False, True, Attributes(1.0, -5.0, None), None),
        ),
    )
)  # fmt: skip
ACK = wire_control.encode_ack(wire_control.Ack(2, 1, 0b1000_0000_0000_0000_0000_0000_0000_0101))


def data(kind: int, tail: bytes = TAIL, *, attempt: int = 0, sequence: int = 4, listing: bytes = b"") -> bytes:
    options = {"is_ack_wanted": True, "attempt": attempt, "hop_limit": 9, "urgency": 3}
    return wire.encode(kind, tail, **options, sequence=sequence, listing=listing)


BODIES = {
    "hello": HELLO,
    "ack": ACK,
    "probe": data(wire.PROBE, b""),
    "unicast": data(wire.UNICAST),
    "multicast": data(wire.MULTICAST, listing=wire.forward_list(HOPS)),
    "routed": data(wire.ROUTED, listing=wire.route_list([B, C])),
    "flood": data(wire.FLOOD, listing=wire.relay_list([hop._replace(destinations=()) for hop in HOPS])),
    "tc": data(wire.TC, wire.tail_of(0x55, 8, TC), listing=wire.relay_list([])),
}


def member_frame(body: bytes, *, source: bytes = MEMBER_A, to: bytes = MEMBER_B) -> Packet:
    return Ether(src=source.hex(":"), dst=to.hex(":"), type=0x88B6) / body


def reason(body: bytes) -> list[str]:
    """Why a node drops a body, as its counters name it; a stranger's bodies count as those of a neighbour."""
    kind = body[0]
    if kind == wire.HELLO:
        found: object = wire_control.decode_hello(body)
    elif kind not in wire.KINDS or kind in (wire.AGGREGATE, wire.SEALED):
        found = Drop.VERSION
    elif kind == wire.ACK:
        found = wire_control.decode_ack(body)
    else:
        found = wire.decode(body)
        if not isinstance(found, Drop) and kind == wire.TC:
            found = wire_control.decode_tc(wire.inner_of(found.tail))
    return [found.value] if isinstance(found, Drop) else []


def told(row: Row, *names: str) -> list[list[str]]:
    return [row[f"wnet.{name}"] for name in names]


def row_of(tshark: Tshark, tape: Tape, body: bytes, *names: str) -> Row:
    tape.frame(bytes(member_frame(body)) + bytes(7))  # short frames are padded
    (row,) = tshark.rows(tape.path, *[f"wnet.{name}" for name in ("bad", *names)], "udp_mesh.hello.name", where="wnet")
    assert row["wnet.bad"] == []
    return row


def test_hello_has_every_field(tshark: Tshark, tape: Tape) -> None:
    names = ["hello.member", "node", "epoch", "hello.sequence", "hello.interval", "hello.digest", "hello.partial"]
    names += ["address", "group", "link.node", "link.usable", "link.mpr", "link.id", "link.snr"]
    names += ["link.epoch", "link.peer_member", "link.own_member"]
    row = row_of(tshark, tape, HELLO, *names, "link.loss", "link.rate", "utilisation", "hello.own_utilisation")
    assert told(row, *names) == [
        ["2"], [A.hex(":")], ["0x00000055"], ["77"], ["1500"], ["0x0000abcd"], ["1"],
        ["10.0.0.1", "10.0.0.2"], [B.hex(":")], [B.hex(":"), C.hex(":")], ["1", "0"], ["0", "1"], ["3", "0"],
        ["30", "-5"], ["0x00000066", "0x00000067"], ["1", "0"], ["2", "0"],
    ]  # fmt: skip
    sent = wire_control.decode_hello(HELLO)
    assert isinstance(sent, wire_control.Hello)
    expected = [attributes for link in sent.links for attributes in (link.incoming, link.outgoing) if attributes]
    assert list(map(float, row["wnet.link.loss"])) == pytest.approx([each.loss_ratio for each in expected], abs=1e-6)
    assert [round(float(rate)) for rate in row["wnet.link.rate"]] == [sent.links[0].incoming.rate_bps]
    assert float(row["wnet.utilisation"][0]) == pytest.approx(sent.info.utilisation_ratio, abs=1e-6)
    assert float(row["wnet.hello.own_utilisation"][0]) == pytest.approx(sent.own_utilisation_ratio, abs=1e-6)


def test_a_tc_and_an_acknowledgement(tshark: Tshark, tape: Tape) -> None:
    old = data(wire.TC, wire.tail_of(0x55, 8, TC), sequence=25, listing=wire.relay_list([]))
    aggregate = wire.aggregate([old, ACK])
    names = ["kind", "node", "epoch", "sequence", "tc.interval", "address", "group", "link.node", "link.id", "link.snr"]
    row = row_of(tshark, tape, aggregate, *names, "tc.age", "link_sequence", "ack.newest", "ack.try", "ack.sequence")
    assert float(row["wnet.tc.age"][0]) == pytest.approx(25 * wire.AGE_UNIT_S)
    assert row["wnet.link_sequence"] == [], "a TC has its age in that place"
    assert told(row, *names) == [
        ["0x19", "0x18", "0x12"], [A.hex(":")], ["0x00000055"], ["8"], ["5"], ["10.0.0.1"], [B.hex(":")],
        [B.hex(":")], ["3"], ["20"],
    ]  # fmt: skip
    assert told(row, "ack.newest", "ack.try", "ack.sequence") == [["2"], ["1"], ["2", "1", "65535", "65506"]]


@pytest.mark.parametrize("kind", ["unicast", "multicast", "routed", "flood"])
def test_data_is_followed_inwards(tshark: Tshark, tape: Tape, kind: str) -> None:
    names = ["ack_wanted", "try", "hop_limit", "urgency", "epoch", "sequence", "length"]
    lists = ["hop.member", "hop.destination", "route", "link_sequence"]
    row = row_of(tshark, tape, BODIES[kind], *names, *lists)
    assert told(row, *names) == [["1"], ["0"], ["9"], ["3"], ["0x11223344"], ["7"], [str(len(INNER))]]
    hops = [MEMBER_B.hex(":"), MEMBER_A.hex(":")]
    nodes = [B.hex(":"), C.hex(":")]
    assert (
        told(row, *lists)
        == {
            "unicast": [[], [], [], ["4"]],
            "multicast": [hops, nodes, [], ["4", "5", "9"]],
            "routed": [[], [], nodes, ["4"]],
            "flood": [hops, [], [], ["4", "5", "9"]],
        }[kind]
    )
    assert row["udp_mesh.hello.name"] == ["base"]


def test_a_frame_is_followed_from_hop_to_hop(tshark: Tshark, tape: Tape) -> None:
    tape.frame(member_frame(data(wire.UNICAST, sequence=4)), 0.0, interface="a/wlan0")
    tape.frame(member_frame(data(wire.UNICAST, sequence=4, attempt=1)), 0.01, interface="a/wlan0")
    tape.frame(member_frame(data(wire.UNICAST, sequence=4, attempt=1)), 0.012, interface="b/wlan0")
    ack = wire_control.encode_ack(wire_control.Ack(4, 1, 0))
    for at_s in (0.015, 0.02):  # told once more: the first counts
        tape.frame(member_frame(ack, source=MEMBER_B, to=MEMBER_A), at_s, interface="a/wlan0")
    names = [f"wnet.{name}" for name in ("first_seen_in", "transit_time", "retransmission", "acked_in", "acked_after")]
    rows = tshark.rows(tape.path, *names, where="wnet")
    assert [row[names[0]] for row in rows] == [[], ["1"], ["1"], [], []]
    assert [row[names[1]] for row in rows] == [[], ["0.010000000"], ["0.012000000"], [], []]
    assert [row[names[2]] for row in rows] == [[], ["1"], ["1"], [], []]
    assert [row[names[3]] for row in rows] == [[], ["4"], [], [], []]
    assert rows[1][names[4]] == ["0.005000000"]
    assert tshark.experts(tape.path)["Retransmission to the next hop"] == 2


def relay_story(tape: Tape, *, left_s: float, urgent_s: float) -> None:
    """At relay r something less urgent leaves, and then what is more urgent and had arrived at ``urgent_s``."""
    urgent = data(wire.UNICAST)
    other = wire.encode(
        wire.UNICAST, wire.tail_of(1, 8, INNER), is_ack_wanted=True, attempt=0, hop_limit=9, urgency=6, sequence=5
    )
    to_c = {"source": MEMBER_B, "to": bytes.fromhex("020000000003")}
    tape.frame(member_frame(urgent), urgent_s, interface="r/wlan0", direction=INBOUND)
    tape.frame(member_frame(other, **to_c), left_s, interface="r/wlan1", direction=OUTBOUND)
    tape.frame(member_frame(urgent, **to_c), 0.1, interface="r/wlan1", direction=OUTBOUND)


def test_a_relay_that_sends_what_is_less_urgent_first(tshark: Tshark, new_tape: Callable[[], Tape]) -> None:
    early, in_order = new_tape(), new_tape()
    relay_story(early, urgent_s=0.0, left_s=0.05)
    relay_story(in_order, urgent_s=0.0495, left_s=0.05)  # within the grace
    names = [f"wnet.inversion.{name}" for name in ("urgency", "waited", "done_in")]
    rows = tshark.rows(early.path, *names, where="wnet.inversion")
    assert [list(row.values()) for row in rows] == [[["2"], ["3"], ["0.050000000"], ["3"]]]
    assert tshark.experts(early.path)["Priority inversion at a relay"] == 1
    assert tshark.rows(in_order.path, where="wnet.inversion") == []


def test_what_is_sealed_stays_closed(tshark: Tshark, tape: Tape) -> None:
    head = MEMBER_B + MEMBER_A + wire.ETHERTYPE
    sealed = Seal([bytes(32)], epoch=0x99).seal(head, HELLO)
    names = ["seal.key_id", "seal.counter", "seal.epoch", "seal.body"]
    row = row_of(tshark, tape, sealed, *names)
    assert told(row, *names) == [[f"0x{sealed[1]:02x}"], ["1"], ["0x00000099"], [sealed[14:].hex()]]


@pytest.mark.parametrize("seed", range(2))
def test_damage_is_named_as_wnet_names_it(tshark: Tshark, tape: Tape, seed: int) -> None:
    rng = Random(seed)
    bodies = []
    while len(bodies) < 400:
        body = bytearray(rng.choice(list(BODIES.values())))
        body[rng.randrange(1, len(body))] = rng.randrange(256)
        bodies.append(bytes(body[: rng.choice([len(body), rng.randrange(1, len(body))])]))
    for at, body in enumerate(bodies):
        tape.frame(member_frame(body), at * 0.001)
    rows = tshark.rows(tape.path, "wnet.bad", where="frame")
    found = [(body.hex(), row["wnet.bad"]) for body, row in zip(bodies, rows, strict=True)]
    assert found == [(body.hex(), reason(body)) for body in bodies]
    assert {"too_short", "malformed", "check"} == {name for body in bodies for name in reason(body)}


def test_no_bytes_upset_it(tshark: Tshark, tape: Tape) -> None:
    rng = Random(3)
    for at in range(400):
        kind = rng.choice(sorted(wire.KINDS))
        tape.frame(member_frame(bytes([kind]) + rng.randbytes(rng.randrange(90))), at * 0.001)
        parts = [rng.choice(list(BODIES.values()))[: rng.randrange(1, 40)] for _ in range(3)]
        tape.frame(member_frame(wire.aggregate(parts)), at * 0.001)
    assert "wnet" in tshark(tape.path, "-2", "-V", "-Y", "frame")
