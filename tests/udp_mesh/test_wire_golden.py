"""The wire format: bytes written down once, and decoders that swallow anything."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core import wire
from udp_mesh.core.packets import Link
from udp_mesh.core.wire_links import encode_link, mark_bridged

HEADER = "754d 01 02 1122334455667788 00000007 000a00000000"
DATA = "01 00 09 0005 000000000003 0000 0002 01 74 616263"
ACK = "02 000000000009 00000001 00000002 0004 01 0000 0002"
LINK = "10 01 00f4 00001388 02 02 00000003 00000004"
HELLO = "03 03e8 000000000004 02 04 00000001 00000002 62617365"


def header(flags: int = wire.FLAG_ACK_NOW) -> bytes:
    return wire.encode_header(epoch=0x1122334455667788, destination_tag=7, packet_number=0x000A00000000, flags=flags)


def test_every_frame_has_the_documented_bytes() -> None:
    data = wire.encode_data_header(message_id=3, priority=9, index=0, count=2, payload_bytes=3, topic=b"t") + b"abc"
    later = wire.encode_data_header(message_id=3, priority=9, index=1, count=2, payload_bytes=1) + b"d"
    assert header() == bytes.fromhex(HEADER)
    assert data == bytes.fromhex(DATA)
    assert later == bytes.fromhex("01 00 09 0001 000000000003 0001 0002 64")
    assert wire.encode_ack([(5, 9), (1, 3)], received_us=1, delay_us=2, room_bytes=100) == bytes.fromhex(ACK)
    assert wire.encode_hello(name="base", beacon_interval_s=1.0, floor=4, heard=[1, 2]) == bytes.fromhex(HELLO)
    assert wire.encode_probe([3]) == bytes.fromhex("04 01 00000003")
    assert wire.encode_probe([0, 3]) == bytes.fromhex("04 02 00000000 00000003")  # 0 asks everybody
    assert bytes.fromhex("05") == wire.PING
    assert wire.encode_floor(0x010000000002) == bytes.fromhex("06 010000000002")
    assert wire.encode_backlog(3) == bytes.fromhex("08 03")
    assert wire.encode_purged(2) == bytes.fromhex("07 000000000002")
    assert encode_link(Link(1, 244, 5000, 2, (3, 4))) == bytes.fromhex(LINK)
    assert encode_link(Link(255, 1 << 20, 1 << 40, 1000, ())) == bytes.fromhex("10 ff ffff ffffffff ff 00")
    assert mark_bridged(bytes.fromhex(HEADER)) == bytes.fromhex(HEADER.replace(" 02 ", " 0a ", 1))


def test_a_datagram_of_all_frames_is_dissected() -> None:
    frames = (
        HEADER + DATA + ACK + HELLO + "04 02 00000000 00000003" + "05" + "06 000000000002" + "07 000000000008" + "08 03"
    )
    packet = wire.dissect(bytes.fromhex(frames + LINK))
    bridged = wire.dissect(mark_bridged(bytes.fromhex(frames + LINK)))
    assert packet is not None
    assert bridged == packet._replace(is_bridged=True)
    assert packet.links == (Link(1, 244, 5000, 2, (3, 4)),)
    assert (packet.epoch, packet.destination_tag, packet.packet_number) == (0x1122334455667788, 7, 0xA00000000)
    assert packet.ack_now
    assert not packet.is_broadcast
    assert packet.is_ack_eliciting
    (fragment,) = packet.fragments
    assert fragment[:5] == (3, 9, "t", 0, 2)
    assert fragment.payload == b"abc"
    assert packet.acks == (wire.Ack(((5, 9), (1, 3)), 1, 2),)
    assert packet.acks[0].largest == 9
    assert packet.beacons == (wire.Hello("base", 1.0, 4, (1, 2)),)
    assert packet.backlogs == (3,)
    assert (packet.probes, packet.pings, packet.floors, packet.purged) == ((0, 3), 1, (2,), (8,))


@pytest.mark.parametrize(("flags", "wanted"), [("00", (False, False)), ("02", (True, False)), ("10", (False, True))])
def test_a_packet_says_how_soon_it_is_to_be_acknowledged(flags: str, wanted: tuple[bool, bool]) -> None:
    packet = wire.dissect(bytes.fromhex(HEADER.replace(" 02 ", f" {flags} ", 1) + DATA))
    assert packet is not None
    assert (packet.ack_now, packet.ack_later) == wanted


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", wire.BadDatagram.FOREIGN),
        ("00" * 30, wire.BadDatagram.FOREIGN),
        ("754d01", wire.BadDatagram.TRUNCATED),
        (HEADER.replace(" 01 ", " 02 ", 1), wire.BadDatagram.VERSION),
        (HEADER.replace(" 02 ", " 80 ", 1), wire.BadDatagram.FLAGS),
        (HEADER + "ff", wire.BadDatagram.FRAME),
        (HEADER + DATA[:-2], wire.BadDatagram.TRUNCATED),
        (HEADER + DATA.replace("0000 0002", "0002 0002"), wire.BadDatagram.VALUE),  # index not below count
        (HEADER + DATA.replace("01 74", "09 74"), wire.BadDatagram.VALUE),  # topic longer than the frame
        (HEADER + DATA.replace("01 74", "01 ff"), wire.BadDatagram.VALUE),  # not UTF-8
        (HEADER + ACK.replace("0004 01", "ffff 01"), wire.BadDatagram.VALUE),  # below packet 0
        (HEADER + LINK[:-2], wire.BadDatagram.TRUNCATED),
        (HEADER + HELLO.replace("02 04", "02 05"), wire.BadDatagram.TRUNCATED),
        (HEADER + HELLO.replace("62617365", "62610a65"), wire.BadDatagram.VALUE),  # a line feed in a name
    ],
)
def test_damage_is_named(text: str, reason: wire.BadDatagram) -> None:
    data = bytes.fromhex(text)
    assert wire.decode(data) is reason
    assert wire.dissect(data) is None


@given(st.binary(max_size=200))
def test_any_bytes_are_dissected_without_an_exception(data: bytes) -> None:
    wire.dissect(data)
    wire.dissect(header() + data)


@given(st.data())
def test_a_damaged_datagram_is_dissected_without_an_exception(data: st.DataObject) -> None:
    whole = bytearray(bytes.fromhex(HEADER + HELLO + LINK + ACK + DATA))
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    wire.dissect(bytes(whole[: data.draw(st.integers(0, len(whole)))]))


@st.composite
def descending_ranges(draw: st.DrawFn) -> list[tuple[int, int]]:
    at = draw(st.integers(200_000, wire.MAX_NUMBER))
    ranges = []
    for _ in range(draw(st.integers(1, 40))):
        first = at - draw(st.integers(0, 100))
        ranges.append((first, at))
        at = first - 2 - draw(st.integers(0, 100))
    return ranges


@given(descending_ranges(), st.integers(18, 400))
def test_acknowledged_ranges_survive_the_wire_newest_first(ranges: list[tuple[int, int]], room_bytes: int) -> None:
    frame = wire.encode_ack(ranges, received_us=1 << 40, delay_us=5, room_bytes=room_bytes)
    assert len(frame) <= room_bytes
    packet = wire.dissect(header() + frame)
    assert packet is not None
    (ack,) = packet.acks
    assert list(ack.ranges) == ranges[: len(ack.ranges)]
