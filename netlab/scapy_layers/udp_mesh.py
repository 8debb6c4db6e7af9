"""udp_mesh as scapy layers (docs/wire.md): a header and a list of frames. A length or count left out is computed.

``UdpMesh(epoch=1, frames=[Data(topic=b"t", data=b"x"), Ping()])`` builds, ``UdpMesh(datagram)`` dissects. Nothing is
checked in either direction, so that impossible frames can be built; what scapy cannot cut into frames becomes ``Raw``.
On UDP port 8700 scapy finds the layer by itself. Other protocols share the EtherType of the Ethernet carrier: name
:class:`EthernetCarrier` there.
"""

# ruff: noqa: RUF012 - scapy wants the fields of a layer as a plain list in its class

from __future__ import annotations

from scapy.base_classes import BasePacket
from scapy.fields import (
    BitField,
    ByteField,
    ConditionalField,
    FieldLenField,
    FieldListField,
    FlagsField,
    IntField,
    PacketListField,
    ShortField,
    StrField,
    StrFixedLenField,
    StrLenField,
    XByteField,
    XIntField,
    XLongField,
)
from scapy.layers.inet import UDP
from scapy.packet import Packet, Raw, bind_layers

PORT = 8700
HEADER_FLAGS = ["unnumbered", "ack_now", "sealed", "bridged"]
SEAL_BYTES = 8


class Frame(Packet):
    """What all frames have in common: the next one follows where this one ends."""

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes]:
        """Leave what follows to the list of frames."""
        return b"", s


def _is_first(frame: Packet) -> bool:
    return bool(frame.index == 0)


def _topic_bytes(frame: Packet) -> int:
    if not _is_first(frame):
        return 0
    return 1 + (len(frame.topic) if frame.topic_length is None else int(frame.topic_length))


class Data(Frame):
    """A fragment of a message; ``topic`` only in fragment 0."""

    name = "DATA"
    fields_desc = [
        ByteField("type", 1),
        FlagsField("flags", 0, 8, ["envelope"]),
        ByteField("priority", 100),
        FieldLenField("length", None, length_of="data", adjust=lambda frame, size: size + _topic_bytes(frame)),
        BitField("message_id", 0, 48),
        ShortField("index", 0),
        ShortField("count", 1),
        ConditionalField(FieldLenField("topic_length", None, fmt="B", length_of="topic"), _is_first),
        ConditionalField(StrLenField("topic", b"", length_from=lambda frame: frame.topic_length), _is_first),
        StrLenField("data", b"", length_from=lambda frame: max(0, frame.length - _topic_bytes(frame))),
    ]


class AckRange(Frame):
    """``gap + 1`` packets missing, then ``length + 1`` packets received."""

    name = "range"
    fields_desc = [ShortField("gap", 0), ShortField("length", 0)]


class Ack(Frame):
    """What was received: ``largest`` and ``first_range`` packets below it, then ``ranges``."""

    name = "ACK"
    fields_desc = [
        ByteField("type", 2),
        BitField("largest", 0, 48),
        IntField("received_us", 0),
        IntField("delay_us", 0),
        ShortField("first_range", 0),
        FieldLenField("further", None, fmt="B", count_of="ranges"),
        PacketListField("ranges", [], AckRange, count_from=lambda frame: frame.further),
    ]


class Hello(Frame):
    """A beacon, or the answer to a probe."""

    name = "HELLO"
    fields_desc = [
        ByteField("type", 3),
        ShortField("interval_ms", 1000),
        BitField("floor", 0, 48),
        FieldLenField("tags", None, fmt="B", count_of="heard"),
        FieldLenField("name_length", None, fmt="B", length_of="node"),
        FieldListField("heard", [], XIntField("tag", 0), count_from=lambda frame: frame.tags),
        StrLenField("node", b"", length_from=lambda frame: frame.name_length),
    ]


class Probe(Frame):
    """Looks for the nodes with these tags; 0 asks everybody."""

    name = "PROBE"
    fields_desc = [
        ByteField("type", 4),
        FieldLenField("tags", None, fmt="B", count_of="wanted"),
        FieldListField("wanted", [], XIntField("tag", 0), count_from=lambda frame: frame.tags),
    ]


class Ping(Frame):
    """Asks for an acknowledgement."""

    name = "PING"
    fields_desc = [ByteField("type", 5)]


class Floor(Frame):
    """Every message below is settled."""

    name = "FLOOR"
    fields_desc = [ByteField("type", 6), BitField("message_id", 0, 48)]


class Purged(Frame):
    """A partial message was given up."""

    name = "PURGED"
    fields_desc = [ByteField("type", 7), BitField("message_id", 0, 48)]


class Backlog(Frame):
    """Something of this priority waits."""

    name = "BACKLOG"
    fields_desc = [ByteField("type", 8), ByteField("priority", 0)]


class Link(Frame):
    """Whom a bridge reaches by one of its carriers."""

    name = "LINK"
    fields_desc = [
        ByteField("type", 16),
        ByteField("number", 0),
        ShortField("mtu_bytes", 1472),
        IntField("rate_bps", 0),
        ByteField("rounds", 1),
        FieldLenField("tags", None, fmt="B", count_of="reached"),
        FieldListField("reached", [], XIntField("tag", 0), count_from=lambda frame: frame.tags),
    ]


FRAMES: dict[int, type[Frame]] = {
    1: Data, 2: Ack, 3: Hello, 4: Probe, 5: Ping, 6: Floor, 7: Purged, 8: Backlog, 16: Link,
}  # fmt: skip


def _next_frame(_packet: Packet, _frames: list[BasePacket], _last: Packet | None, rest: bytes) -> type[Packet] | None:
    return FRAMES.get(rest[0], Raw) if rest else None


def _is_sealed(packet: Packet) -> bool:
    return bool(packet.flags.sealed)


class UdpMesh(Packet):
    """One datagram. What is sealed stays closed: its frames and its tag are ``sealed``."""

    name = "udp_mesh"
    fields_desc = [
        StrFixedLenField("magic", b"uM", 2),
        ByteField("version", 1),
        FlagsField("flags", 0, 8, HEADER_FLAGS),
        XLongField("epoch", 0),
        XIntField("destination_tag", 0),
        BitField("packet_number", 0, 48),
        ConditionalField(XByteField("key_id", 0), _is_sealed),
        ConditionalField(ByteField("series", 0), _is_sealed),
        ConditionalField(BitField("seal_number", 0, 48), _is_sealed),
        ConditionalField(StrField("sealed", b""), _is_sealed),
        ConditionalField(PacketListField("frames", [], next_cls_cb=_next_frame), lambda packet: not _is_sealed(packet)),
    ]


class EthernetCarrier(Packet):
    """What precedes a datagram in an Ethernet frame: its length."""

    name = "udp_mesh over Ethernet"
    fields_desc = [ShortField("length", None)]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        """Compute the length where none was given."""
        return (len(pay).to_bytes(2, "big") if self.length is None else pkt) + pay

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes]:
        """Split the datagram from the padding of short frames."""
        return s[: self.length], s[self.length :]


bind_layers(UDP, UdpMesh, sport=PORT)
bind_layers(UDP, UdpMesh, dport=PORT)
bind_layers(UDP, UdpMesh, sport=PORT, dport=PORT)
bind_layers(EthernetCarrier, UdpMesh)
