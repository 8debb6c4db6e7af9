"""Message bytes of one channel -> typed records. The counterpart of the encoders in :mod:`netlab.capture.schemas`."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Protocol, cast

from google.protobuf.descriptor_pb2 import FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Channel

from netlab.capture.records import JsonRecord, LogLine, PacketRecord, Record, VerdictRecord, kind_of
from netlab.capture.schemas import Direction, LogLevel, packet_file, verdict_file
from netlab.medium.verdicts import Verdict

Decoder = Callable[[int, bytes], Record]
"""(log time in ns, data) -> record; raises ValueError or DecodeError on damaged data."""


class _Packet(Protocol):
    frame_crc32: int
    original_length: int
    linktype: int
    direction: int
    node: str
    interface: str
    frame: bytes


class _Verdict(Protocol):
    sender_node: str
    sender_interface: str
    receiver_node: str
    receiver_interface: str
    verdict: int
    departs_ns: int
    length: int
    crc32: int
    attempts: int
    rssi_dbm: int


def decoder_for(channel: Channel, schema: str) -> Decoder | None:
    """Return the decoder for a channel, None if its messages are not netlab's."""
    match schema:
        case "netlab.Packet":
            return _packet_decoder()
        case "netlab.Verdict":
            return _verdict_decoder()
        case "foxglove.Log":
            return _log_decoder(channel.topic)
        case "foxglove.SceneUpdate" | "foxglove.FrameTransforms" if channel.message_encoding == "protobuf":
            return _scene_decoder(channel.topic)
    return _json_decoder(channel.topic) if channel.message_encoding == "json" else None


def _packet_decoder() -> Decoder:
    parse = cast(Callable[[bytes], _Packet], _message_class(packet_file()).FromString)
    direction, unknown = {member.value: member for member in Direction}, Direction.UNKNOWN

    def decode(log_ns: int, data: bytes) -> PacketRecord:
        packet = parse(data)
        return PacketRecord(
            log_ns,
            packet.node,
            packet.interface,
            direction.get(packet.direction, unknown),
            packet.linktype,
            packet.original_length,
            packet.frame_crc32,
            packet.frame,
        )

    return decode


def _verdict_decoder() -> Decoder:
    parse = cast(Callable[[bytes], _Verdict], _message_class(verdict_file()).FromString)
    verdicts = {member.value: member for member in Verdict}

    def decode(log_ns: int, data: bytes) -> VerdictRecord:
        record = parse(data)
        verdict = verdicts.get(record.verdict)
        if verdict is None:
            raise ValueError(f"there is no verdict {record.verdict}")
        return VerdictRecord(
            log_ns,
            (record.sender_node, record.sender_interface),
            (record.receiver_node, record.receiver_interface),
            verdict,
            record.departs_ns,
            record.length,
            record.crc32,
            record.attempts,
            record.rssi_dbm if record.attempts else None,
        )

    return decode


def _log_decoder(topic: str) -> Decoder:
    from foxglove_schemas_protobuf.Log_pb2 import Log  # only readers of logs pay for its import

    _, node, _, process = topic.split("/", 3) if topic.count("/") > 2 else ("", "", "", topic)

    def decode(log_ns: int, data: bytes) -> LogLine:
        entry = Log.FromString(data)
        return LogLine(log_ns, node, process, LogLevel(entry.level), entry.message)

    return decode


def _scene_decoder(topic: str) -> Decoder | None:
    """The map and the poses as the lab told them; scenes that are only drawn say nothing new."""
    from netlab.capture import foxglove  # only readers of places pay for its import

    decoders = {"/map": foxglove.decode_map, "/poses": foxglove.decode_poses}
    if topic not in decoders:
        return None
    kind, payload_of = kind_of(topic), decoders[topic]
    return lambda log_ns, data: JsonRecord(log_ns, kind, topic, "", payload_of(data))


def _json_decoder(topic: str) -> Decoder:
    kind = kind_of(topic)
    node = topic.split("/")[1] if topic.count("/") > 1 else ""

    def decode(log_ns: int, data: bytes) -> JsonRecord:
        payload = json.loads(data)
        if not isinstance(payload, dict):
            raise ValueError(f"{topic}: not a JSON object")
        return JsonRecord(log_ns, kind, topic, node, payload)

    return decode


def _message_class(file: FileDescriptorProto) -> type[Message]:
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"{file.package}.{file.message_type[0].name}"))
