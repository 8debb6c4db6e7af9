"""Every field of every frame as tshark tells it, against the project's own decoder, packet for packet."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest

from tests.scapy_layers.odd_frames import ODD, damaged, odd_datagram, random_datagram
from tests.wireshark.tshark_rig import Row, Tape, Tshark
from udp_mesh.core import wire
from udp_mesh.core.packets import BadDatagram, Dissection

GOLDEN = (
    "754d 01 02 1122334455667788 00000007 000a00000000"
    "01 00 09 0005 000000000003 0000 0002 01 74 616263"
    "02 000000000009 00000001 00000002 0004 01 0000 0002"
    "03 03e8 000000000004 02 04 00000001 00000002 62617365"
    "04 02 00000000 00000003 05 06 000000000002 07 000000000008 08 03"
    "10 01 00f4 00001388 02 02 00000003 00000004"
)
SEALED_LEAST_BYTES = wire.HEADER_BYTES + wire.SEAL_BYTES

#: Field -> its values in a decoded datagram. Those of one name that several kinds of frames share are sorted.
FIELDS: dict[str, Callable[[Dissection], list[object]]] = {
    "epoch": lambda p: [f"0x{p.epoch:016x}"],
    "destination_tag": lambda p: [f"0x{p.destination_tag:08x}"],
    "packet_number": lambda p: [p.packet_number],
    "flags.unnumbered": lambda p: [int(p.is_unnumbered)],
    "flags.ack_now": lambda p: [int(p.ack_now)],
    "flags.bridged": lambda p: [int(p.is_bridged)],
    "message_id": lambda p: [f.message_id for f in p.fragments],
    "priority": lambda p: [f.priority for f in p.fragments],
    "data.envelope": lambda p: [f.flags for f in p.fragments],
    "fragment_index": lambda p: [f.fragment_index for f in p.fragments],
    "fragment_count": lambda p: [f.fragment_count for f in p.fragments],
    "payload": lambda p: [bytes(f.payload).hex() for f in p.fragments if f.payload],
    "ack.largest": lambda p: [a.largest for a in p.acks],
    "ack.received": lambda p: [a.received_us for a in p.acks],
    "ack.delay": lambda p: [a.delay_us for a in p.acks],
    "ack.range": lambda p: [str(a) if a == b else f"{a}-{b}" for ack in p.acks for a, b in ack.ranges],
    "hello.name": lambda p: [h.name for h in p.beacons],
    "hello.interval": lambda p: [round(h.beacon_interval_s * 1000) for h in p.beacons],
    "hello.heard": lambda p: [f"0x{tag:08x}" for h in p.beacons for tag in h.heard],
    "probe.tag": lambda p: [f"0x{tag:08x}" for tag in p.probes],
    "floor": lambda p: sorted(map(str, [*p.floors, *(h.floor for h in p.beacons)])),
    "purged": lambda p: list(p.purged),
    "backlog.priority": lambda p: list(p.backlogs),
    "link.number": lambda p: [link.number for link in p.links],
    "link.mtu": lambda p: [link.mtu_bytes for link in p.links],
    "link.rate": lambda p: [link.rate_bps for link in p.links],
    "link.rounds": lambda p: [link.rounds for link in p.links],
    "link.tag": lambda p: [f"0x{tag:08x}" for link in p.links for tag in link.tags],
}
NAMES = [f"udp_mesh.{name}" for name in FIELDS]


def assert_same(row: Row, packet: Dissection) -> None:
    told = {name: row[f"udp_mesh.{name}"] for name in FIELDS}
    told["floor"].sort()
    assert told == {name: list(map(str, values(packet))) for name, values in FIELDS.items()}


def expected_fault(datagram: bytes) -> list[str]:
    """Why a daemon drops a datagram; one that is sealed is not opened."""
    decoded = wire.decode(datagram)
    if decoded is BadDatagram.SEALED:
        return [] if len(datagram) >= SEALED_LEAST_BYTES else ["truncated"]
    return [decoded.value] if isinstance(decoded, BadDatagram) else []


def test_the_golden_datagram_has_every_field(tshark: Tshark, tape: Tape) -> None:
    tape.add(bytes.fromhex(GOLDEN))
    (row,) = tshark.rows(tape.path, *NAMES, "udp_mesh.frame", "udp_mesh.bad", "udp_mesh.topic")
    packet = wire.dissect(bytes.fromhex(GOLDEN))
    assert packet is not None
    assert_same(row, packet)
    assert row["udp_mesh.frame"] == ["1", "2", "3", "4", "5", "6", "7", "8", "16"]
    assert (row["udp_mesh.topic"], row["udp_mesh.bad"]) == (["t"], [])


@pytest.mark.parametrize("seed", range(3))
def test_whatever_arrives_is_told_as_the_daemon_understands_it(tshark: Tshark, tape: Tape, seed: int) -> None:
    """Half of the datagrams are damaged; sound ones agree in every field, others in the reason of the drop."""
    rng = Random(seed)
    datagrams = [random_datagram(rng) for _ in range(1200)]
    datagrams = [damaged(data, rng) if index % 2 else data for index, data in enumerate(datagrams)]
    datagrams = [data for data in datagrams if data[:2] == wire.MAGIC]
    for index, data in enumerate(datagrams):
        tape.add(data, index * 0.001)
    rows = tshark.rows(tape.path, *NAMES, "udp_mesh.bad")
    assert len(rows) == len(datagrams)
    for row, data in zip(rows, datagrams, strict=True):
        assert (row["udp_mesh.bad"], data.hex()) == (expected_fault(data), data.hex())
        packet = wire.dissect(data)
        if packet is not None:
            assert_same(row, packet)
    reasons = {reason for data in datagrams for reason in expected_fault(data)}
    assert reasons == {"unknown_version", "unknown_flags", "truncated", "unknown_frame", "impossible_value"}


def test_odd_datagrams_are_named_as_the_daemon_names_them(tshark: Tshark, tape: Tape) -> None:
    odd = {name: odd_datagram(name, epoch=7, tag=9, number=at) for at, name in enumerate(ODD)}
    odd = {name: (data, reason) for name, (data, reason) in odd.items() if reason not in ("foreign", "sealed")}
    for data, _reason in odd.values():
        tape.add(data)
    rows = tshark.rows(tape.path, "udp_mesh.bad")
    told = {name: row["udp_mesh.bad"] for name, row in zip(odd, rows, strict=True)}
    assert told == {name: [reason] for name, (_data, reason) in odd.items()}


def test_no_bytes_upset_the_dissectors(tshark: Tshark, tape: Tape) -> None:
    """Noise behind each protocol's opening, in both passes and with the whole tree."""
    rng = Random(7)
    for index in range(600):
        noise = rng.randbytes(rng.randrange(0, 120))
        header = bytes.fromhex(GOLDEN)[: wire.HEADER_BYTES]
        tape.add(header + noise, index * 0.001)
        tape.add(b"uM" + noise, index * 0.001)
        tape.add(header[:3] + b"\4" + noise, index * 0.001)
        kind = bytes.fromhex("020000000001 020000000002 88b5")
        tape.frame(kind + noise, index * 0.001)
        tape.frame(kind + b"\1" + noise, index * 0.001)
        tape.frame(kind + len(noise).to_bytes(2, "big") + header + noise, index * 0.001)
    assert "udp_mesh" in tshark(tape.path, "-V")
    assert "udp_mesh" in tshark(tape.path, "-2", "-V", "-Y", "frame")
