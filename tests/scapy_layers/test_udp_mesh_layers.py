"""The scapy layers speak the same bytes as the core."""

from __future__ import annotations

import subprocess
import sys
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.packet import Packet, Raw

from netlab.flood import wire as flood_wire
from netlab.scapy_layers.flood import Flood
from netlab.scapy_layers.udp_mesh import (
    Ack,
    AckRange,
    Backlog,
    Data,
    EthernetCarrier,
    Floor,
    Hello,
    Link,
    Ping,
    Probe,
    Purged,
    UdpMesh,
)
from tests.scapy_layers.odd_frames import damaged, random_datagram
from udp_mesh.core import packets, wire
from udp_mesh.core.seal import Seal
from udp_mesh.core.wire_links import encode_link

#: Each frame by scapy, and by the core.
PAIRS: list[tuple[Packet, bytes]] = [
    (
        Data(priority=9, message_id=3, count=2, topic=b"t", data=b"abc"),
        wire.encode_data_header(message_id=3, priority=9, index=0, count=2, payload_bytes=3, topic=b"t") + b"abc",
    ),
    (
        Data(flags="envelope", priority=0, message_id=1 << 40, index=1, count=2, data=b"d"),
        wire.encode_data_header(message_id=1 << 40, priority=0, index=1, count=2, payload_bytes=1, flags=1) + b"d",
    ),
    (
        Ack(largest=9, received_us=1, delay_us=2, first_range=4, ranges=[AckRange(gap=0, length=2)]),
        wire.encode_ack([(5, 9), (1, 3)], received_us=1, delay_us=2, room_bytes=100),
    ),
    (
        Hello(interval_ms=1500, floor=4, heard=[1, 2], node=b"base"),
        wire.encode_hello(name="base", beacon_interval_s=1.5, floor=4, heard=[1, 2]),
    ),
    (Probe(wanted=[0, 3]), wire.encode_probe([0, 3])),
    (Ping(), wire.PING),
    (Floor(message_id=1 << 41), wire.encode_floor(1 << 41)),
    (Purged(message_id=2), wire.encode_purged(2)),
    (Backlog(priority=3), wire.encode_backlog(3)),
    (
        Link(number=1, mtu_bytes=244, rate_bps=5000, rounds=2, reached=[3, 4]),
        encode_link(packets.Link(1, 244, 5000, 2, (3, 4))),
    ),
]


@pytest.mark.parametrize(("frame", "encoded"), PAIRS, ids=lambda value: getattr(value, "name", ""))
def test_a_frame_is_built_and_dissected_as_the_core_does(frame: Packet, encoded: bytes) -> None:
    assert bytes(frame) == encoded
    whole = UdpMesh(bytes(UdpMesh(epoch=7, frames=[frame])))
    assert [type(part) for part in whole.frames] == [type(frame)]
    assert bytes(whole.frames[0]) == encoded


@given(st.integers(0, 1 << 32))
def test_any_datagram_comes_back_and_means_the_same(seed: int) -> None:
    datagram = random_datagram(Random(seed))
    packet, scapy = wire.dissect(datagram), UdpMesh(datagram)
    assert packet is not None
    scapy.clear_cache()
    assert bytes(scapy) == datagram
    assert (scapy.epoch, scapy.destination_tag, scapy.packet_number) == packet[:3]
    data = [frame for frame in scapy.frames if isinstance(frame, Data)]
    assert [frame.data for frame in data] == [fragment.payload for fragment in packet.fragments]
    assert [frame.message_id for frame in data] == [fragment.message_id for fragment in packet.fragments]
    hellos = [frame for frame in scapy.frames if isinstance(frame, Hello)]
    assert [(frame.node.decode(), tuple(frame.heard)) for frame in hellos] == [
        (h.name, h.heard) for h in packet.beacons
    ]


@given(st.integers(0, 1 << 32))
def test_what_is_damaged_keeps_its_bytes(seed: int) -> None:
    rng = Random(seed)
    datagram = damaged(random_datagram(rng), rng)
    if len(datagram) >= wire.HEADER_BYTES + 8:  # a header that is not all there is for scapy's caller to see to
        assert bytes(UdpMesh(datagram)) == datagram


def test_lengths_and_counts_can_lie() -> None:
    assert bytes(Data(length=9, topic=b"t", data=b"abc")).hex().startswith("01 00 64 0009".replace(" ", ""))
    assert bytes(Probe(tags=9, wanted=[1])).hex() == "040900000001"
    assert bytes(Hello(name_length=200, node=b"x"))[10] == 200
    assert isinstance(UdpMesh(bytes(UdpMesh(frames=[Raw(b"\xee")]))).frames[0], Raw)


def test_a_sealed_datagram_stays_closed() -> None:
    plain = wire.encode_header(epoch=7, destination_tag=0, packet_number=3, flags=wire.FLAG_UNNUMBERED) + wire.PING
    sealed = Seal([bytes(32)], epoch=7).seal(plain, len(plain), carrier=0)
    packet = UdpMesh(sealed)
    assert bytes(packet) == sealed
    assert (packet.series, packet.seal_number, len(packet.sealed)) == (0, 0, len(wire.PING) + 16)
    assert packet.getfieldval("frames") in (None, [])


def test_carriers_name_their_layers() -> None:
    datagram = UdpMesh(epoch=7, frames=[Ping()])
    assert UdpMesh in Ether(bytes(Ether() / IP(dst="10.0.0.1") / UDP(sport=8700, dport=8700) / datagram))
    carried = EthernetCarrier(bytes(EthernetCarrier() / datagram) + bytes(20))
    assert (carried.length, carried[UdpMesh].original) == (23, bytes(datagram))
    inner = Ether(src="02:00:00:00:00:01", dst="02:00:00:00:00:02", type=0x0800) / Raw(b"abc")
    flood = Flood(hop_limit=3, originator="02:00:00:00:00:09", epoch=5, sequence=6) / inner
    header = flood_wire.Header(3, len(inner), bytes.fromhex("020000000009"), 5, 6)
    assert bytes(flood) == flood_wire.encode(header, bytes(inner))[2:]
    assert Flood(bytes(flood) + bytes(9))[Ether].original == bytes(inner)


def test_without_scapy_it_says_what_to_install() -> None:
    code = "import sys; sys.modules['scapy'] = None\nimport importlib.util as u; u.find_spec = lambda name: None\n"
    code += "import netlab.scapy_layers"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "pip install 'udp-mesh-lab[scapy]'" in done.stderr
