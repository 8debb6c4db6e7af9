"""wnet's bodies as scapy layers (wnet/core/wire.py, wire_control.py): what follows a member's Ethernet header.

Lengths, counts and checksums that are left out are computed, others stay as they are given, so that impossible bodies
can be built. ``Ether(type=ETHERTYPE) / Data(kind=UNICAST) / inner`` builds; :func:`body` dissects.
"""

# ruff: noqa: RUF012 - scapy wants the fields of a layer as a plain list in its class

from __future__ import annotations

from binascii import crc_hqx

from scapy.base_classes import BasePacket
from scapy.fields import (
    BitField,
    ByteField,
    ConditionalField,
    FieldLenField,
    FieldListField,
    FlagsField,
    IntField,
    IPField,
    MACField,
    NBytesField,
    PacketListField,
    ShortField,
    SignedByteField,
    StrLenField,
    XByteField,
    XIntField,
    XShortField,
)
from scapy.layers.l2 import Ether
from scapy.packet import Packet, Raw

ETHERTYPE = 0x88B6
HELLO, ACK, PROBE, UNICAST, MULTICAST, ROUTED, FLOOD, TC, AGGREGATE, SEALED = range(0x11, 0x1B)
_NOWHERE = "00:00:00:00:00:00"
_ORIGIN_BYTES, _KEY_BYTES = 8, 20


def _with_check(data: bytes, at: int, checked_bytes: int) -> bytes:
    """Return it with the checksum at ``at`` of its first bytes, in which it counts as 0."""
    check = crc_hqx(data[:at] + b"\0\0" + data[at + 2 : checked_bytes], 0)
    return data[:at] + check.to_bytes(2, "big") + data[at + 2 :]


class _Part(Packet):
    def extract_padding(self, s: bytes) -> tuple[bytes, bytes]:
        return b"", s


class Heard(_Part):
    """A link of HELLO's sender; losses in 1/255, rates as 8 log2 of kbit/s; out_loss 255: nothing is known."""

    name = "link"
    fields_desc = [
        MACField("node", _NOWHERE),
        XIntField("epoch", 0),
        BitField("peer_member", 0, 4),
        BitField("own_member", 0, 4),
        BitField("usable", 0, 1),
        BitField("mpr", 0, 1),
        BitField("unused", 0, 2),
        BitField("link_id", 0, 4),
        ByteField("loss", 0),
        SignedByteField("snr_db", -128),
        ByteField("rate", 0),
        ByteField("out_loss", 255),
        SignedByteField("out_snr_db", -128),
        ByteField("out_rate", 0),
    ]


class Hello(Packet):
    """What a member tells its neighbours."""

    name = "HELLO"
    fields_desc = [
        XByteField("kind", HELLO),
        FlagsField("flags", 0, 8, ["partial"]),
        XShortField("check", None),
        ByteField("member", 0),
        ByteField("own_utilisation", 0),
        ByteField("utilisation", 0),
        MACField("node", _NOWHERE),
        XIntField("epoch", 0),
        ShortField("sequence", 0),
        ShortField("interval_ms", 1000),
        XIntField("digest", 0),
        FieldLenField("address_count", None, fmt="B", count_of="addresses"),
        FieldLenField("group_count", None, fmt="B", count_of="groups"),
        FieldListField("addresses", [], IPField("address", "0.0.0.0"), count_from=lambda body: body.address_count),
        FieldListField("groups", [], MACField("group", _NOWHERE), count_from=lambda body: body.group_count),
        FieldLenField("link_count", None, fmt="H", count_of="links"),
        PacketListField("links", [], Heard, count_from=lambda body: body.link_count),
    ]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        """Compute the checksum."""
        return (_with_check(pkt, 2, len(pkt)) if self.check is None else pkt) + pay


class Ack(Packet):
    """The newest link sequence that arrived, and those of the 32 before it with a bit."""

    name = "ACK"
    fields_desc = [
        XByteField("kind", ACK),
        ByteField("attempt", 0),
        XShortField("check", None),
        ShortField("newest", 0),
        XIntField("bits", 0),
    ]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        """Compute the checksum."""
        return (_with_check(pkt, 2, len(pkt)) if self.check is None else pkt) + pay


class Hop(_Part):
    """A next hop of MULTICAST and the nodes that it shall forward to."""

    name = "hop"
    fields_desc = [
        MACField("member", _NOWHERE),
        ShortField("link_sequence", 0),
        FieldLenField("count", None, fmt="B", count_of="destinations"),
        FieldListField("destinations", [], MACField("node", _NOWHERE), count_from=lambda hop: hop.count),
    ]


class Relay(_Part):
    """A multipoint relay of FLOOD and TC."""

    name = "relay"
    fields_desc = [MACField("member", _NOWHERE), ShortField("link_sequence", 0)]


def _is_relayed(body: Packet) -> bool:
    return body.kind in (FLOOD, TC)


def _is_multicast(body: Packet) -> bool:
    return bool(body.kind == MULTICAST)


def _is_routed(body: Packet) -> bool:
    return bool(body.kind == ROUTED)


def _has_tail(body: Packet) -> bool:
    return bool(body.kind != PROBE)


class Data(Packet):
    """A body of data, or a probe; the frame inside is its payload. ``link_sequence`` is a TC's age in 0.1 s."""

    name = "wnet data"
    fields_desc = [
        XByteField("kind", UNICAST),
        BitField("unused", 0, 4),
        BitField("attempt", 0, 3),
        BitField("ack_wanted", 0, 1),
        ByteField("hop_limit", 1),
        ByteField("urgency", 6),
        XShortField("check", None),
        ShortField("length", None),
        ShortField("link_sequence", 0),
        ConditionalField(FieldLenField("hop_count", None, fmt="B", count_of="hops"), _is_multicast),
        ConditionalField(PacketListField("hops", [], Hop, count_from=lambda body: body.hop_count), _is_multicast),
        ConditionalField(FieldLenField("relay_count", None, fmt="B", count_of="relays"), _is_relayed),
        ConditionalField(PacketListField("relays", [], Relay, count_from=lambda body: body.relay_count), _is_relayed),
        ConditionalField(FieldLenField("route_count", None, fmt="B", count_of="route"), _is_routed),
        ConditionalField(
            FieldListField("route", [], MACField("node", _NOWHERE), count_from=lambda body: body.route_count),
            _is_routed,
        ),
        ConditionalField(XIntField("epoch", 0), _has_tail),
        ConditionalField(IntField("sequence", 0), _has_tail),
    ]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        """Compute the length of the frame inside, and the checksum of everything down to its addresses."""
        if self.length is None:
            pkt = pkt[:6] + len(pay).to_bytes(2, "big") + pkt[8:]
        if self.check is None:
            checked_bytes = len(pkt) - _ORIGIN_BYTES + _KEY_BYTES if _has_tail(self) else len(pkt)
            return _with_check(pkt + pay, 4, checked_bytes)
        return pkt + pay

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes]:
        """Split the frame inside from the padding of short frames."""
        size = self.length if _has_tail(self) else 0
        return s[:size], s[size:]

    def guess_payload_class(self, payload: bytes) -> type[Packet]:
        """A TC carries no Ethernet frame."""
        return Raw if self.kind == TC else Ether


class Shared(_Part):
    """A body that shares a frame with others, behind its length; 0 ends the list, as in padding."""

    name = "shared"
    fields_desc = [
        FieldLenField("length", None, fmt="H", length_of="body"),
        StrLenField("body", b"", length_from=lambda part: part.length),
    ]


def _next_part(_body: Packet, _parts: list[BasePacket], _last: Packet | None, rest: bytes) -> type[Packet] | None:
    return Shared if rest[:2].strip(b"\0") and len(rest) > 2 else None


class Aggregate(Packet):
    """Bodies in one frame to one neighbour; :func:`body` takes each apart."""

    name = "AGGREGATE"
    fields_desc = [XByteField("kind", AGGREGATE), PacketListField("parts", [], next_cls_cb=_next_part)]


class Sealed(Packet):
    """A body under the team's key: who sealed it, and the encrypted bytes with their tag."""

    name = "SEALED"
    fields_desc = [
        XByteField("kind", SEALED),
        XByteField("key_id", 0),
        NBytesField("counter", 0, 6),
        XIntField("epoch", 0),
        FieldLenField("length", None, fmt="H", length_of="encrypted"),
        StrLenField("encrypted", b"", length_from=lambda body: body.length),
    ]


_LAYERS: dict[int, type[Packet]] = {HELLO: Hello, ACK: Ack, AGGREGATE: Aggregate, SEALED: Sealed}


def body(data: bytes) -> Packet:
    """Return a body, taken apart as far as its kind is known."""
    kind = data[0] if data else 0
    return _LAYERS.get(kind, Data if PROBE <= kind <= TC else Raw)(data)
