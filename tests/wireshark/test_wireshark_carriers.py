"""udp_mesh wherever it travels, and who else is found on the same EtherType."""

from __future__ import annotations

import pytest
from scapy.layers.inet import ICMP, IP, UDP
from scapy.layers.inet6 import IPv6
from scapy.layers.l2 import Dot1Q, Ether
from scapy.packet import Packet, Raw

from netlab.scapy_layers.flood import Flood
from netlab.scapy_layers.udp_mesh import Data, EthernetCarrier, Hello, Ping, UdpMesh
from tests.wireshark.tshark_rig import Tape, Tshark, datagram
from udp_mesh.core import cobs, wire
from udp_mesh.core.seal import Seal
from udp_mesh.core.wire_runs import encode_run

ETHERTYPE = 0x88B5
DLT_USER0 = 147
HELLO = datagram("base", "", 0, Hello(node=b"base"))
SERIAL = ("-o", 'uat:user_dlts:"User 0 (DLT=147)","udp_mesh_serial","0","","0",""')
WHO = ["udp_mesh.hello.name", "_ws.col.Protocol"]


def ethernet(payload: Packet | bytes) -> Packet:
    return Ether(src="02:00:00:00:00:01", dst="ff:ff:ff:ff:ff:ff", type=ETHERTYPE) / payload


@pytest.mark.parametrize(
    "frame",
    [
        Ether() / IP(dst="10.0.0.1") / UDP(sport=8700, dport=8700),
        Ether() / IP(dst="10.0.0.1") / UDP(sport=4000, dport=5000),  # found by its opening
        Ether() / Dot1Q(vlan=5) / IP(dst="10.0.0.1") / UDP(sport=8700, dport=8700),
        Ether() / IPv6(dst="ff02::6d65:7368") / UDP(sport=8700, dport=8700),
        ethernet(EthernetCarrier()),
    ],
    ids=["udp", "other port", "vlan", "udp6", "ethernet"],
)
def test_each_carrier_is_understood(tshark: Tshark, tape: Tape, frame: Packet) -> None:
    tape.frame(frame / HELLO)
    assert tshark.rows(tape.path, *WHO) == [{"frame.number": ["1"], WHO[0]: ["base"], WHO[1]: ["udp_mesh"]}]


def test_padding_and_a_length_that_lies(tshark: Tshark, tape: Tape) -> None:
    tape.frame(ethernet(EthernetCarrier() / HELLO / Raw(b"")) / b"")
    tape.frame(bytes(ethernet(EthernetCarrier(length=len(HELLO)) / HELLO)) + bytes(9))
    tape.frame(ethernet(EthernetCarrier(length=500) / HELLO))
    rows = tshark.rows(tape.path, "udp_mesh.hello.name", "udp_mesh.bad", "udp_mesh_ethernet.padding")
    assert [row["udp_mesh.bad"] for row in rows] == [[], [], []]
    assert [row["udp_mesh_ethernet.padding"] for row in rows] == [[], ["00" * 9], []]
    assert tshark.experts(tape.path)["Longer than the frame"] == 1


def test_other_versions_are_known_by_the_port_alone(tshark: Tshark, tape: Tape) -> None:
    other = UdpMesh(version=2, frames=[Ping()])
    tape.frame(Ether() / IP(dst="10.0.0.1") / UDP(sport=8700, dport=8700) / other)
    tape.frame(Ether() / IP(dst="10.0.0.1") / UDP(sport=4000, dport=5000) / other)
    tape.frame(Ether() / IP(dst="10.0.0.1") / UDP(sport=8700, dport=8700) / b"something else")
    rows = tshark.rows(tape.path, "udp_mesh.bad", where="frame")
    assert [row["udp_mesh.bad"] for row in rows] == [["unknown_version"], [], []]
    words = ("-o", "udp_mesh.ports:5000-5001")
    rows = tshark.rows(tape.path, "udp_mesh.bad", where="frame", words=words)
    assert [row["udp_mesh.bad"] for row in rows] == [[], ["unknown_version"], []]


def test_a_frame_of_a_serial_line_is_unstuffed(tshark: Tshark, tape: Tape) -> None:
    line = cobs.encode(b"\0\0\x12\x34" + bytes(HELLO))
    damaged = cobs.encode(b"\0\0\x12\x34" + bytes(HELLO)).replace(b"base", b"bAse")
    for frame in (line, line[:-1], damaged, b"\xff\1\2", b"\0"):
        tape.frame(frame, linktype=DLT_USER0)
    names = ["udp_mesh.hello.name", "udp_mesh_serial.target", "udp_mesh_serial.source"]
    rows = tshark.rows(tape.path, *names, words=SERIAL)
    expected = {names[0]: ["base"], names[1]: ["0x0000"], names[2]: ["0x1234"]}
    assert rows == [{"frame.number": [str(number)], **expected} for number in (1, 2)]
    experts = tshark.experts(tape.path, *SERIAL)
    assert (experts["Damaged: wrong CRC-32"], experts["Damaged: no COBS frame"]) == (1, 2)


def test_long_frames_of_a_serial_line(tshark: Tshark, tape: Tape) -> None:
    """Blocks of 254 bytes and more have no zero between them."""
    payload = bytes(range(1, 256)) * 3 + bytes(300)
    whole = datagram("base", "", 0, Data(topic=b"t", data=payload))
    tape.frame(cobs.encode(b"\0\0\x12\x34" + bytes(whole)), linktype=DLT_USER0)
    (row,) = tshark.rows(tape.path, "udp_mesh.payload", "udp_mesh.bad", words=SERIAL)
    assert (row["udp_mesh.payload"], row["udp_mesh.bad"]) == ([payload.hex()], [])


def test_what_is_sealed_stays_closed_but_is_followed(tshark: Tshark, tape: Tape) -> None:
    seal = Seal([b"k" * 32], epoch=HELLO.epoch)
    header = wire.encode_header(epoch=HELLO.epoch, destination_tag=0, packet_number=3, flags=wire.FLAG_UNNUMBERED)
    plain = header + wire.PING
    sealed = [seal.seal(plain, len(plain), carrier=0) for _ in range(2)]
    for at_s, data in enumerate([sealed[0], sealed[0], sealed[1][:-1], sealed[0][:40]]):
        tape.add(data, at_s)
    names = [f"udp_mesh.seal.{name}" for name in ("key_id", "series", "number", "frames")]
    rows = tshark.rows(tape.path, *names, "udp_mesh.bad", "udp_mesh.duplicate_of", "udp_mesh.frame")
    assert [row[names[0]] for row in rows] == [[f"0x{sealed[0][22]:02x}"]] * 3 + [[]]
    assert [row[names[2]] for row in rows] == [["0"], ["0"], ["1"], []]
    assert [row["udp_mesh.duplicate_of"] for row in rows] == [[], ["1"], ["1"], []]
    assert [row["udp_mesh.bad"] for row in rows] == [[], [], [], ["truncated"]]
    assert rows[0][names[3]] == [sealed[0][30:-16].hex()]
    assert all(row["udp_mesh.frame"] == [] for row in rows)


def test_a_burst_that_was_captured_uncut(tshark: Tshark, tape: Tape) -> None:
    """A capture on the sender may hold what its kernel cuts later (UDP_SEGMENT)."""
    payloads = [memoryview(b"x" * 50) for _ in range(4)]
    payloads[0] = payloads[0][:48]
    burst = encode_run(
        epoch=5, destination_tag=7, packet_number=10, message_id=3, priority=2, flags=0, fragment_index=0,
        fragment_count=9, prefix=b"\1t", payloads=payloads, ack_now=True,
    )  # fmt: skip
    tape.add(burst)
    (row,) = tshark.rows(tape.path, "udp_mesh.packet_number", "udp_mesh.fragment_index", "udp_mesh.bad")
    assert row["udp_mesh.packet_number"] == ["10", "11", "12", "13"]
    assert (row["udp_mesh.fragment_index"], row["udp_mesh.bad"]) == (["0", "1", "2", "3"], [])


def test_a_datagram_quoted_in_an_error_is_not_one_that_was_sent(tshark: Tshark, tape: Tape) -> None:
    packet = IP(src="10.0.0.1", dst="10.0.0.2") / UDP(sport=8700, dport=8700) / datagram("base", "robot", 0, Ping())
    tape.frame(Ether() / IP(src="10.0.0.2", dst="10.0.0.1") / ICMP(type=3, code=3) / packet)
    tape.frame(Ether() / packet, 0.1)
    rows = tshark.rows(tape.path, "udp_mesh.duplicate_of", "udp_mesh.first_seen_in")
    assert [row["udp_mesh.duplicate_of"] + row["udp_mesh.first_seen_in"] for row in rows] == [[], []]


def test_the_flood_and_udp_mesh_share_an_ethertype(tshark: Tshark, tape: Tape) -> None:
    inner = Ether(src="02:00:00:00:00:05", dst="ff:ff:ff:ff:ff:ff") / IP(dst="10.0.0.1") / UDP(sport=8700, dport=8700)
    flood = Flood(hop_limit=3, originator="02:00:00:00:00:05", epoch=5, sequence=6) / inner / HELLO
    tape.frame(bytes(ethernet(flood)) + bytes(4))
    tape.frame(ethernet(EthernetCarrier() / HELLO))
    tape.frame(ethernet(Flood(check=1, sequence=9) / inner))
    tape.frame(ethernet(Flood(length=9000) / inner))
    tape.frame(ethernet(Raw(b"\7 nobody's frame")))
    names = ["hop_limit", "originator", "epoch", "sequence", "length"]
    rows = tshark.rows(tape.path, *[f"netlab_flood.{name}" for name in names], *WHO, where="frame")
    assert list(rows[0].values())[1:6] == [["3"], ["02:00:00:00:00:05"], ["0x0005"], ["6"], [str(len(inner / HELLO))]]
    assert [row[WHO[0]] for row in rows] == [["base"], ["base"], [], [], []]
    assert [bool(row["netlab_flood.sequence"]) for row in rows] == [True, False, True, True, False]
    experts = tshark.experts(tape.path)
    assert experts["Wrong check: nobody takes it"] == experts["Impossible length: nobody takes it"] == 1


def test_copies_of_relays_are_no_duplicates(tshark: Tshark, tape: Tape) -> None:
    """On a member's radio a datagram passes once by each relay, and once more on the mesh's own interface."""
    inner = Ether(src="02:00:00:00:00:05") / IP(dst="10.0.0.1") / UDP(sport=8700, dport=8700) / HELLO
    tape.frame(inner, 0.0, interface="mesh0")
    for at_s, relay in ((0.1, "02:00:00:00:00:01"), (0.2, "02:00:00:00:00:02"), (0.3, "02:00:00:00:00:02")):
        flood = Flood(hop_limit=3, originator="02:00:00:00:00:05", epoch=5, sequence=6) / inner
        tape.frame(Ether(src=relay, dst="ff:ff:ff:ff:ff:ff", type=ETHERTYPE) / flood, at_s, interface="radio0")
    rows = tshark.rows(tape.path, "udp_mesh.duplicate_of", "udp_mesh.first_seen_in")
    assert [row["udp_mesh.duplicate_of"] for row in rows] == [[], [], [], ["3"]]
    assert [row["udp_mesh.first_seen_in"] for row in rows] == [[], ["1"], ["1"], ["1"]]
