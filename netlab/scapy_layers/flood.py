"""The flood's header as a scapy layer (netlab/flood/wire.py), with the whole Ethernet frame inside as its payload.

Other protocols share its EtherType: name :class:`Flood` where a frame is dissected.
"""

# ruff: noqa: RUF012 - scapy wants the fields of a layer as a plain list in its class

from __future__ import annotations

from binascii import crc_hqx

from scapy.fields import ByteField, IntField, MACField, ShortField, XShortField
from scapy.layers.l2 import Ether
from scapy.packet import Packet, bind_layers

_CHECK_AT, _CHECKED_AT = 2, 4


class Flood(Packet):
    """``check`` and ``length`` are computed where they are left out."""

    name = "flood"
    fields_desc = [
        ByteField("version", 1),
        ByteField("hop_limit", 1),
        XShortField("check", None),
        ShortField("length", None),
        MACField("originator", "00:00:00:00:00:00"),
        XShortField("epoch", 0),
        IntField("sequence", 0),
    ]

    def post_build(self, pkt: bytes, pay: bytes) -> bytes:
        """Compute length and check."""
        if self.length is None:
            pkt = pkt[:_CHECKED_AT] + len(pay).to_bytes(2, "big") + pkt[_CHECKED_AT + 2 :]
        if self.check is None:
            pkt = pkt[:_CHECK_AT] + crc_hqx(pkt[_CHECKED_AT:], 0).to_bytes(2, "big") + pkt[_CHECKED_AT:]
        return pkt + pay

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes]:
        """Split the frame inside from the padding of short frames."""
        return s[: self.length], s[self.length :]


bind_layers(Flood, Ether)
