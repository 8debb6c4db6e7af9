"""Bytes on the wire: the only module that knows the layout (docs/wire.md) and the only user of ``struct`` in the core.

Decoding never raises: a datagram is understood as a whole or dropped, with a reason. Nothing of peers or state here.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from udp_mesh.core.packets import Ack, BadDatagram, DataFragment, Dissection, Hello, Link
from udp_mesh.core.wire_links import FLAG_BRIDGED, LINK_HEAD, TAG, TYPE_LINK

__all__ = ["Ack", "BadDatagram", "DataFragment", "Dissection", "Hello", "decode", "dissect"]

MAGIC = b"uM"
VERSION = 1
FLAG_UNNUMBERED = 0x01
FLAG_ACK_NOW = 0x02
FLAG_SEALED = 0x04  # frames are encrypted (udp_mesh/core/wire_seal.py)
FLAG_ACK_LATER = 0x10
_KNOWN_FLAGS = FLAG_UNNUMBERED | FLAG_ACK_NOW | FLAG_BRIDGED | FLAG_ACK_LATER
DATA_FLAG_ENVELOPE = 0x01  # the message's payload begins with an envelope (udp_mesh/core/envelope.py)
_HEADER = struct.Struct("!2sBBQIHI")  # magic, version, flags, sender epoch, destination tag, packet number (48 bits)
_DATA = struct.Struct(
    "!BBBHHIHH"
)  # type, flags, priority, length, message id (48 bits), fragment index, fragment count
_ACK = struct.Struct("!BHIIIHB")  # type, largest (48 bits), received_us, delay_us, first range, further ranges
_ACK_RANGE = struct.Struct("!HH")  # gap, length
_HELLO = struct.Struct("!BHHIBB")  # type, beacon interval ms, floor (48 bits), tags, length of the name
_PROBE = struct.Struct("!BB")  # type, tags
_BACKLOG = struct.Struct("!BB")  # type, priority
_MESSAGE = struct.Struct("!BHI")  # type (FLOOR or PURGED), message id (48 bits)
TYPE_DATA, _TYPE_ACK, _TYPE_HELLO, _TYPE_PROBE, _TYPE_PING, _TYPE_FLOOR, _TYPE_PURGED, _TYPE_BACKLOG = range(1, 9)

HEADER_BYTES = _HEADER.size
HELLO_BYTES = _HELLO.size  # without the name
DATA_BYTES = _DATA.size
SEAL_BYTES = 24  # what a key adds to a datagram
PING = bytes([_TYPE_PING])
MAX_NUMBER = (1 << 48) - 1
MAX_FRAGMENTS = 0xFFFF
MAX_NAME_BYTES = 63
MAX_TOPIC_BYTES = 255
MAX_TAGS = 255
_LOW_32 = 0xFFFFFFFF
_Buffer = bytes | memoryview


class _DecodeError(Exception):
    def __init__(self, reason: BadDatagram) -> None:
        self.reason = reason


def tag_of(epoch: int) -> int:
    """Return the short form of an epoch that addresses a node: its low 32 bits."""
    return epoch & _LOW_32


def encode_header(*, epoch: int, destination_tag: int, packet_number: int, flags: int) -> bytes:
    """Return the 22 bytes that open every datagram."""
    return _HEADER.pack(
        MAGIC, VERSION, flags, epoch, destination_tag, packet_number >> 32 & 0xFFFF, packet_number & _LOW_32
    )


def encode_data_header(
    *, message_id: int, priority: int, index: int, count: int, payload_bytes: int, topic: bytes = b"", flags: int = 0
) -> bytes:
    """Return the bytes before a fragment's payload; ``topic`` (1..255 bytes of UTF-8) only for fragment 0."""
    prefix = bytes([len(topic)]) + topic if index == 0 else b""
    length = len(prefix) + payload_bytes
    return _DATA.pack(TYPE_DATA, flags, priority, length, message_id >> 32, message_id & _LOW_32, index, count) + prefix


def first_fragment_overhead_bytes(topic: bytes) -> int:
    """Return how much less payload fragment 0 carries than the others."""
    return 1 + len(topic)


def encode_ack(ranges: Sequence[tuple[int, int]], *, received_us: int, delay_us: int, room_bytes: int) -> bytes:
    """Return an acknowledgement of as many ``ranges`` (inclusive, newest first, disjoint) as fit, at least one.

    A range longer than 65536 packets keeps its newest ones; a gap too wide for 16 bits ends the list.
    """
    first, largest = ranges[0]
    length = min(largest - first, 0xFFFF)
    lowest = largest - length
    parts: list[bytes] = []
    limit = min(255, (room_bytes - _ACK.size) // _ACK_RANGE.size)
    for start, end in ranges[1:]:
        gap = lowest - end - 2
        if len(parts) >= limit or gap > 0xFFFF:
            break
        size = min(end - start, 0xFFFF)
        parts.append(_ACK_RANGE.pack(gap, size))
        lowest = end - size
    head = _ACK.pack(
        _TYPE_ACK,
        largest >> 32,
        largest & _LOW_32,
        received_us & _LOW_32,
        min(delay_us, _LOW_32),
        length,
        len(parts),
    )
    return head + b"".join(parts)


def encode_hello(*, name: str, beacon_interval_s: float, floor: int, heard: Sequence[int] = ()) -> bytes:
    """Return a beacon frame; ``heard`` (at most 255 tags) answers probes."""
    encoded = name.encode()
    interval_ms = max(0, min(0xFFFF, round(beacon_interval_s * 1000)))
    head = _HELLO.pack(_TYPE_HELLO, interval_ms, floor >> 32, floor & _LOW_32, len(heard), len(encoded))
    return head + b"".join(map(TAG.pack, heard)) + encoded


def encode_probe(tags: Sequence[int]) -> bytes:
    """Return a frame that asks the nodes with these tags (at most 255) to answer."""
    return _PROBE.pack(_TYPE_PROBE, len(tags)) + b"".join(map(TAG.pack, tags))


def encode_floor(message_id: int) -> bytes:
    """Return a frame that says: every message below ``message_id`` is settled, expect no more of them."""
    return _MESSAGE.pack(_TYPE_FLOOR, message_id >> 32, message_id & _LOW_32)


def encode_purged(message_id: int) -> bytes:
    """Return a frame that says: what I had of this message is gone, also what I had acknowledged."""
    return _MESSAGE.pack(_TYPE_PURGED, message_id >> 32, message_id & _LOW_32)


def encode_backlog(priority: int) -> bytes:
    """Return a frame that says: something of this priority (0..255) waits here for the medium."""
    return _BACKLOG.pack(_TYPE_BACKLOG, priority)


def dissect(datagram: _Buffer) -> Dissection | None:
    """Decode a datagram; None for anything that is not ours or is damaged. Never raises."""
    decoded = decode(datagram)
    return decoded if isinstance(decoded, Dissection) else None


def decode(datagram: _Buffer) -> Dissection | BadDatagram:
    """Decode a datagram, or say why it cannot be. Never raises."""
    if len(datagram) < HEADER_BYTES:
        return BadDatagram.TRUNCATED if bytes(datagram[:2]) == MAGIC else BadDatagram.FOREIGN
    magic, version, flags, epoch, tag, number_high, number_low = _HEADER.unpack_from(datagram)
    if magic != MAGIC:
        return BadDatagram.FOREIGN
    if version != VERSION:
        return BadDatagram.VERSION
    if flags & ~_KNOWN_FLAGS:
        return BadDatagram.SEALED if flags & FLAG_SEALED else BadDatagram.FLAGS
    frames = _Frames()
    try:
        frames.decode(memoryview(datagram))
    except struct.error:
        return BadDatagram.TRUNCATED
    except UnicodeDecodeError:
        return BadDatagram.VALUE
    except _DecodeError as error:
        return error.reason
    return Dissection(
        epoch,
        tag,
        number_high << 32 | number_low,
        bool(flags & FLAG_UNNUMBERED),
        bool(flags & FLAG_ACK_NOW),
        tuple(frames.fragments),
        tuple(frames.acks),
        tuple(frames.beacons),
        tuple(frames.probes),
        tuple(frames.floors),
        tuple(frames.purged),
        frames.pings,
        tuple(frames.backlogs),
        bool(flags & FLAG_BRIDGED),
        tuple(frames.links),
        bool(flags & FLAG_ACK_LATER),
    )


class _Frames:
    """Collects the frames of one datagram; raises ``_DecodeError``, ``struct.error`` or ``UnicodeDecodeError``."""

    __slots__ = ("acks", "backlogs", "beacons", "floors", "fragments", "links", "pings", "probes", "purged")

    def __init__(self) -> None:
        self.fragments: list[DataFragment] = []
        self.acks: list[Ack] = []
        self.beacons: list[Hello] = []
        self.probes: list[int] = []
        self.floors: list[int] = []
        self.purged: list[int] = []
        self.pings = 0
        self.backlogs: list[int] = []
        self.links: list[Link] = []

    def decode(self, view: memoryview) -> None:
        at, end = HEADER_BYTES, len(view)
        while at < end:
            kind = view[at]
            if kind == TYPE_DATA:
                at = self._data(view, at)
            elif kind == _TYPE_ACK:
                at = self._ack(view, at)
            elif kind == _TYPE_HELLO:
                at = self._hello(view, at)
            elif kind == _TYPE_PROBE:
                _kind, count = _PROBE.unpack_from(view, at)
                tags, at = _tags(view, at + _PROBE.size, count)
                self.probes.extend(tags)
            elif kind == _TYPE_PING:
                self.pings, at = self.pings + 1, at + 1
            elif kind == _TYPE_BACKLOG:
                self.backlogs.append(_BACKLOG.unpack_from(view, at)[1])
                at += _BACKLOG.size
            elif kind == TYPE_LINK:
                _kind, link, mtu_bytes, rate_bps, rounds, count = LINK_HEAD.unpack_from(view, at)
                tags, at = _tags(view, at + LINK_HEAD.size, count)
                self.links.append(Link(link, mtu_bytes, rate_bps, rounds, tags))
            elif kind in (_TYPE_FLOOR, _TYPE_PURGED):
                _kind, high, low = _MESSAGE.unpack_from(view, at)
                (self.floors if kind == _TYPE_FLOOR else self.purged).append(high << 32 | low)
                at += _MESSAGE.size
            else:
                raise _DecodeError(BadDatagram.FRAME)

    def _data(self, view: memoryview, at: int) -> int:
        length: int
        _kind, flags, priority, length, id_high, id_low, index, count = _DATA.unpack_from(view, at)
        at += DATA_BYTES
        end = at + length
        if end > len(view):
            raise _DecodeError(BadDatagram.TRUNCATED)
        if index >= count or flags & ~DATA_FLAG_ENVELOPE:
            raise _DecodeError(BadDatagram.VALUE)
        topic = None
        if index == 0:
            topic_end = at + 1 + view[at] if length else end + 1
            if topic_end > end or topic_end == at + 1:
                raise _DecodeError(BadDatagram.VALUE)
            topic = str(view[at + 1 : topic_end], "utf-8")
            at = topic_end
        message_id = id_high << 32 | id_low
        self.fragments.append(DataFragment(message_id, priority, topic, index, count, view[at:end], flags))
        return end

    def _ack(self, view: memoryview, at: int) -> int:
        _kind, high, low, received_us, delay_us, length, further = _ACK.unpack_from(view, at)
        at += _ACK.size
        largest = high << 32 | low
        ranges = [(largest - length, largest)]
        for _ in range(further):
            gap, length = _ACK_RANGE.unpack_from(view, at)
            at += _ACK_RANGE.size
            last = ranges[-1][0] - gap - 2
            ranges.append((last - length, last))
        if ranges[-1][0] < 0:
            raise _DecodeError(BadDatagram.VALUE)
        self.acks.append(Ack(tuple(ranges), received_us, delay_us))
        return at

    def _hello(self, view: memoryview, at: int) -> int:
        name_bytes: int
        _kind, interval_ms, high, low, tag_count, name_bytes = _HELLO.unpack_from(view, at)
        heard, at = _tags(view, at + _HELLO.size, tag_count)
        end = at + name_bytes
        if end > len(view):
            raise _DecodeError(BadDatagram.TRUNCATED)
        if not 0 < name_bytes <= MAX_NAME_BYTES:
            raise _DecodeError(BadDatagram.VALUE)
        name = str(view[at:end], "utf-8")
        if not name.isprintable():
            raise _DecodeError(BadDatagram.VALUE)
        self.beacons.append(Hello(name, interval_ms / 1000, high << 32 | low, heard))
        return end


def _tags(view: memoryview, at: int, count: int) -> tuple[tuple[int, ...], int]:
    end = at + count * TAG.size
    if end > len(view):
        raise _DecodeError(BadDatagram.TRUNCATED)
    return tuple(tag for (tag,) in TAG.iter_unpack(view[at:end])), end
