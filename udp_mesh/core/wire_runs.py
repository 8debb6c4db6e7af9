"""Runs on the wire: consecutive packets that carry consecutive fragments of one message, and nothing else.

A run is no frame of its own, only many equal datagrams made or read in one go: the headers differ in the packet number
and the fragment index alone. Whatever does not fit this pattern is the business of :mod:`udp_mesh.core.wire`.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from udp_mesh.core.wire import DATA_BYTES, DATA_FLAG_ENVELOPE, FLAG_ACK_NOW, HEADER_BYTES, MAGIC, TYPE_DATA, VERSION

# Header: magic and version, flags, epoch and tag, packet number; DATA: all before the index, index, count
_PACKET = struct.Struct("!3sB12sHI11sHH")
_ADDRESS = struct.Struct("!QI")  # epoch, destination tag
_FRAME = struct.Struct("!BBBHHI")  # DATA before the index: type, flags, priority, length, message id
_OPENING = MAGIC + bytes([VERSION])
_LOW_32 = 0xFFFFFFFF
_HEADS_BYTES = HEADER_BYTES + DATA_BYTES


class Run(NamedTuple):
    """``len(payloads)`` packets: the k-th has number ``packet_number + k`` and fragment ``fragment_index + k``.

    Never the last fragment of its message. ``topic`` is None unless fragment 0 is among them; ``topic_bytes`` is what
    the topic takes from fragment 0. ``ack_now``: the last packet asks for an acknowledgement at once.
    """

    epoch: int
    destination_tag: int
    packet_number: int
    message_id: int
    priority: int
    flags: int
    fragment_index: int
    fragment_count: int
    topic: str | None
    topic_bytes: int
    payloads: list[memoryview]
    ack_now: bool


def encode_run(
    *,
    epoch: int,
    destination_tag: int,
    packet_number: int,
    message_id: int,
    priority: int,
    flags: int,
    fragment_index: int,
    fragment_count: int,
    prefix: bytes,
    payloads: list[memoryview],
    ack_now: bool,
) -> bytes:
    """Return the datagrams of a run, one after the other, all of one length.

    Args:
        prefix: What precedes the payload of fragment 0 (the topic); empty if the run does not begin with it.
        payloads: What the fragments carry. With the prefix of the first, all have one length.
        ack_now: Whether the last packet asks for an acknowledgement at once.
    """
    address = _ADDRESS.pack(epoch, destination_tag)
    length = len(prefix) + len(payloads[0])
    frame = _FRAME.pack(TYPE_DATA, flags, priority, length, message_id >> 32, message_id & _LOW_32)
    parts: list[bytes | memoryview] = []
    number, index, last = packet_number, fragment_index, packet_number + len(payloads) - 1
    for payload in payloads:
        header_flags = FLAG_ACK_NOW if ack_now and number == last else 0
        parts.append(
            _PACKET.pack(_OPENING, header_flags, address, number >> 32, number & _LOW_32, frame, index, fragment_count)
        )
        parts.append(payload)
        number += 1
        index += 1
    parts.insert(1, prefix)
    return b"".join(parts)


def decode_run(datagrams: memoryview, segment_bytes: int) -> Run | None:
    """Return the run at the beginning of a burst, None if there are not at least two packets of one there.

    What it returns is as valid as what :func:`udp_mesh.core.wire.decode` would make of each packet. Never raises.
    """
    if segment_bytes <= _HEADS_BYTES or len(datagrams) < 2 * segment_bytes:
        return None
    opening, header_flags, address, high, low, frame, index, count = _PACKET.unpack_from(datagrams)
    kind, flags, priority, length, id_high, id_low = _FRAME.unpack(frame)
    if opening != _OPENING or header_flags or kind != TYPE_DATA or _HEADS_BYTES + length != segment_bytes:
        return None
    if flags & ~DATA_FLAG_ENVELOPE:
        return None
    topic, topic_bytes = None, 0
    if index == 0:
        topic, topic_bytes = _topic(datagrams[_HEADS_BYTES:segment_bytes])
        if topic is None:
            return None
    most = min(len(datagrams) // segment_bytes, count - 1 - index, _LOW_32 - low)
    size, ack_now = 0, False
    while size < most and not ack_now:
        packet = _PACKET.unpack_from(datagrams, size * segment_bytes)
        if packet != (_OPENING, 0, address, high, low + size, frame, index + size, count):
            if packet != (_OPENING, FLAG_ACK_NOW, address, high, low + size, frame, index + size, count):
                break
            ack_now = True
        size += 1
    if size < 2:
        return None
    ends = range(segment_bytes, (size + 1) * segment_bytes, segment_bytes)
    payloads = [datagrams[end - length : end] for end in ends]
    payloads[0] = payloads[0][topic_bytes:]
    epoch, tag = _ADDRESS.unpack(address)
    message_id = id_high << 32 | id_low
    number = high << 32 | low
    return Run(epoch, tag, number, message_id, priority, flags, index, count, topic, topic_bytes, payloads, ack_now)


def _topic(frame: memoryview) -> tuple[str | None, int]:
    """Return the topic at the beginning of fragment 0 and what it takes of it; None if there is none."""
    end = 1 + frame[0]
    if not 1 < end <= len(frame):
        return None, 0
    try:
        return str(frame[1:end], "utf-8"), end
    except UnicodeDecodeError:
        return None, 0
