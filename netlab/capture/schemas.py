"""Schemas of the capture's channels, and the encoding of the two that occur by the ten thousand per second.

Owns the meaning of every message on disk: protobuf for packets and verdicts, ``foxglove.Log`` for logs, JSON for the
rest but places (:mod:`netlab.capture.foxglove`). Knows nothing of files and sockets. Fixed-width fields keep the
encoding of a packet to one ``struct`` call.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

from netlab.medium.verdicts import Verdict

SchemaMaker = Callable[[], "Schema"]


class Direction(IntEnum):
    """Which way a packet went at the interface that saw it; values as in ``sockaddr_ll.sll_pkttype`` grouped."""

    UNKNOWN = 0
    INBOUND = 1
    OUTBOUND = 2


class LogLevel(IntEnum):
    """The levels of ``foxglove.Log``."""

    UNKNOWN = 0
    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4
    FATAL = 5


@dataclass(frozen=True, slots=True)
class Schema:
    """One MCAP schema record and the encoding of the messages that follow it."""

    name: str
    encoding: str  # of the schema
    message_encoding: str
    data: bytes


_F = FieldDescriptorProto
_PACKET_FIELDS = (
    ("frame_crc32", _F.TYPE_FIXED32),
    ("original_length", _F.TYPE_FIXED32),
    ("linktype", _F.TYPE_FIXED32),
    ("direction", "Direction"),
    ("node", _F.TYPE_STRING),
    ("interface", _F.TYPE_STRING),
    ("frame", _F.TYPE_BYTES),
)
_VERDICT_FIELDS = (
    ("sender_node", _F.TYPE_STRING),
    ("sender_interface", _F.TYPE_STRING),
    ("receiver_node", _F.TYPE_STRING),
    ("receiver_interface", _F.TYPE_STRING),
    ("verdict", "Reason"),
    ("departs_ns", _F.TYPE_FIXED64),
    ("length", _F.TYPE_FIXED32),
    ("crc32", _F.TYPE_FIXED32),
    ("attempts", _F.TYPE_UINT32),
    ("rssi_dbm", _F.TYPE_SINT32),
)


def packet_file() -> FileDescriptorProto:
    """Describe ``netlab.Packet``: one link-layer frame as one interface saw it."""
    return _file("netlab/Packet.proto", "Packet", _PACKET_FIELDS, "Direction", Direction)


def verdict_file() -> FileDescriptorProto:
    """Describe ``netlab.Verdict``: the medium's decision on one frame for one receiver."""
    return _file("netlab/Verdict.proto", "Verdict", _VERDICT_FIELDS, "Reason", Verdict)


def _file(
    path: str, name: str, fields: tuple[tuple[str, int | str], ...], enum_name: str, enum: type[IntEnum]
) -> FileDescriptorProto:
    file = FileDescriptorProto(name=path, package="netlab", syntax="proto3")
    message = file.message_type.add(name=name)
    values = message.enum_type.add(name=enum_name).value
    for member in enum:
        values.add(name=member.name, number=member.value)
    for number, (field_name, kind) in enumerate(fields, start=1):
        field = message.field.add(name=field_name, number=number, label=_F.LABEL_OPTIONAL)
        if isinstance(kind, str):
            field.type, field.type_name = _F.TYPE_ENUM, f".netlab.{name}.{kind}"
        else:
            field.type = _F.Type.ValueType(kind)
    return file


def packet_schema() -> Schema:
    """The schema of ``/<node>/<interface>/packets``."""
    return _protobuf("netlab.Packet", packet_file())


def verdict_schema() -> Schema:
    """The schema of ``/air/verdicts``."""
    return _protobuf("netlab.Verdict", verdict_file())


def log_schema() -> Schema:
    """The schema of ``/<node>/log/<process>``, well known to Foxglove."""
    from foxglove_schemas_protobuf.Log_pb2 import Log  # its import costs a start 20 ms that a run may not need
    from mcap_protobuf.schema import build_file_descriptor_set

    return Schema("foxglove.Log", "protobuf", "protobuf", build_file_descriptor_set(Log).SerializeToString())


def encode_log(t_ns: int, level: LogLevel, name: str, message: str) -> bytes:
    """Encode one ``foxglove.Log``."""
    from foxglove_schemas_protobuf.Log_pb2 import Log

    entry = Log(level=Log.Level.ValueType(level), message=message, name=name)
    entry.timestamp.FromNanoseconds(t_ns)
    return entry.SerializeToString()


def _protobuf(name: str, file: FileDescriptorProto) -> Schema:
    return Schema(name, "protobuf", "protobuf", FileDescriptorSet(file=[file]).SerializeToString())


_NS = {"type": "integer", "description": "CLOCK_REALTIME, nanoseconds"}
_JSON_SCHEMAS: dict[str, dict[str, object]] = {
    "netlab.Timeline": {
        "properties": {
            "t_ns": _NS,
            "at_s": {"type": "number", "description": "scheduled scenario time"},
            "label": {"type": "string"},
            "kind": {"type": "string"},
            "restores": {"description": "the two nodes that can hear each other again, or null"},
            "reroutes": {"description": "pairs of nodes of a mesh that still had a path after this cut; may be absent"},
            "rejoins": {"description": "pairs of nodes of a mesh that had a path again; may be absent"},
        },
        "required": ["t_ns", "kind"],
    },
    "netlab.Links": {"properties": {"t_ns": _NS}, "required": ["t_ns"]},
    "netlab.Event": {"properties": {"t_ns": _NS, "event": {"type": "string"}}, "required": ["event"]},
    "netlab.Published": {
        "properties": {
            "event": {"const": "published"},
            "stream": {"type": "integer"},
            "seq": {"type": "integer"},
            "t_ns": _NS,
            "size_bytes": {"type": "integer"},
            "accepted": {"type": "boolean"},
            "reason": {"type": ["string", "null"]},
        },
        "required": ["stream", "seq", "t_ns", "size_bytes"],
    },
    "netlab.Received": {
        "properties": {
            "event": {"const": "received"},
            "stream": {"type": "integer"},
            "seq": {"type": "integer"},
            "published_ns": _NS,
            "t_ns": _NS,
            "latency_s": {"type": "number", "description": "publish call to receipt, seconds"},
            "size_bytes": {"type": "integer"},
            "source": {"type": "string"},
        },
        "required": ["stream", "seq", "published_ns", "t_ns", "size_bytes"],
    },
}


_LAB_TOPICS = {
    "/timeline": "netlab.Timeline",
    "/links": "netlab.Links",
}


def json_schema_for(topic: str) -> Schema:
    """Return the JSON schema of a topic that is neither packets nor verdicts nor a log."""
    if topic in _LAB_TOPICS:
        name = _LAB_TOPICS[topic]
    elif topic.endswith("/traffic/published"):
        name = "netlab.Published"
    elif topic.endswith("/traffic/received"):
        name = "netlab.Received"
    else:
        name = "netlab.Event"
    body = {"$schema": "https://json-schema.org/draft/2020-12/schema", "type": "object", **_JSON_SCHEMAS[name]}
    return Schema(name, "jsonschema", "json", json.dumps(body).encode())


# Tag = field number << 3 | wire type (5: fixed32, 1: fixed64, 0: varint, 2: length-delimited).
_PACKET_HEAD = struct.Struct("<BIBIBIBB")
_INBOUND = bytes((0x20, Direction.INBOUND))
_VERDICT_TAIL = struct.Struct("<BBBQBIBI")
_VERDICT_TAGS = (0x28, 0x31, 0x3D, 0x45)


def encode_packet(
    crc32: int, original_length: int, linktype: int, direction: int, names: bytes, frame_length: int
) -> bytes:
    """Encode all of a ``netlab.Packet`` but its frame, whose bytes must follow: the frame is not copied here.

    Args:
        names: From :func:`encode_packet_names`, the same for all packets of an interface.
    """
    head = _PACKET_HEAD.pack(0x0D, crc32, 0x15, original_length, 0x1D, linktype, 0x20, direction)
    return head + names + b"\x3a" + varint(frame_length)


def is_inbound(data: bytes) -> bool:
    """Whether these are the bytes of a ``netlab.Packet`` from :func:`encode_packet` that came in."""
    return data[15:17] == _INBOUND and data[:1] == b"\x0d" and data[5:6] == b"\x15" and data[10:11] == b"\x1d"


def encode_packet_names(node: str, interface: str) -> bytes:
    """Encode the part of a packet that never changes on its channel."""
    return _text(5, node) + _text(6, interface)


def encode_verdict_ends(sender: tuple[str, str], receiver: tuple[str, str]) -> bytes:
    """Encode the part of a verdict that belongs to its directed pair; each end is (node, interface)."""
    return _text(1, sender[0]) + _text(2, sender[1]) + _text(3, receiver[0]) + _text(4, receiver[1])


def encode_verdict(ends: bytes, verdict: int, departs_ns: int, length: int, crc32: int) -> bytes:
    """Encode one ``netlab.Verdict``; ``ends`` is from :func:`encode_verdict_ends`."""
    return ends + _VERDICT_TAIL.pack(0x28, verdict, 0x31, departs_ns, 0x3D, length, 0x45, crc32)


def verdict_shape(data: bytes) -> bytes:
    """Return a ``netlab.Verdict`` without ``departs_ns`` and ``crc32``, which tell one frame from the next.

    It decodes like any other, and equal shapes can be counted before they are. What :func:`encode_verdict` would have
    laid out otherwise is returned as it is.
    """
    try:
        at = data[1] + 2  # behind each of the four names
        at += data[at + 1] + 2
        at += data[at + 1] + 2
        at += data[at + 1] + 2
        tags = (data[at], data[at + 2], data[at + 11], data[at + 16])
    except IndexError:
        return data
    end = at + _VERDICT_TAIL.size
    is_ours = tags == _VERDICT_TAGS and end <= len(data)
    return data[: at + 2] + data[at + 11 : at + 16] + data[end:] if is_ours else data


def encode_attempts(attempts: int, rssi_dbm: int) -> bytes:
    """Encode what a ``netlab.Verdict`` of an 802.11 radio has besides, to be put behind :func:`encode_verdict`."""
    zigzag = rssi_dbm << 1 if rssi_dbm >= 0 else -2 * rssi_dbm - 1
    return b"\x48" + varint(attempts) + b"\x50" + varint(zigzag)


def _text(number: int, text: str) -> bytes:
    data = text.encode()
    return bytes((number << 3 | 2,)) + varint(len(data)) + data


def varint(value: int) -> bytes:
    """Encode a non-negative integer as protobuf's base-128 varint."""
    if value < 0x80:
        return bytes((value,))
    if value < 0x4000:
        return bytes((value & 0x7F | 0x80, value >> 7))
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
