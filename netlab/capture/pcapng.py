"""Writes pcapng: one section, one interface block per captured interface, one enhanced packet block per packet.

Source: draft-ietf-opsawg-pcapng. Block types and option codes are quoted at their use.
"""

from __future__ import annotations

import struct
from typing import BinaryIO

_SECTION_HEADER = 0x0A0D0D0A
_BYTE_ORDER = 0x1A2B3C4D
_INTERFACE = 1
_ENHANCED_PACKET = 6
_OPT_COMMENT = 1
_SHB_USERAPPL = 4
_IF_NAME = 2
_IF_DESCRIPTION = 3
_IF_TSRESOL = 9
_EPB_FLAGS = 2
_NANOSECONDS = b"\x09"  # if_tsresol: 10 ** -9
INBOUND = 1
OUTBOUND = 2


class PcapngWriter:
    """One section in native order; interfaces first come, first numbered."""

    def __init__(self, file: BinaryIO, *, application: str, comment: str = "") -> None:
        self._file = file
        self._interfaces = 0
        options = _option(_OPT_COMMENT, comment.encode()) if comment else b""
        options += _option(_SHB_USERAPPL, application.encode())
        self._block(_SECTION_HEADER, struct.pack("=IHHq", _BYTE_ORDER, 1, 0, -1) + _end(options))

    def add_interface(self, name: str, *, linktype: int, snaplen: int, description: str = "") -> int:
        """Declare an interface with nanosecond stamps; return its number for :meth:`add_packet`."""
        options = _option(_IF_NAME, name.encode())
        options += _option(_IF_DESCRIPTION, description.encode()) if description else b""
        options += _option(_IF_TSRESOL, _NANOSECONDS)
        self._block(_INTERFACE, struct.pack("=HHI", linktype, 0, snaplen) + _end(options))
        self._interfaces += 1
        return self._interfaces - 1

    def add_packet(
        self,
        interface: int,
        t_ns: int,
        frame: bytes,
        *,
        original_length: int,
        direction: int = 0,
        comments: tuple[str, ...] = (),
    ) -> None:
        """Write a packet; ``direction`` is 0 (unknown), ``INBOUND`` or ``OUTBOUND``."""
        head = struct.pack("=IIIII", interface, t_ns >> 32, t_ns & 0xFFFFFFFF, len(frame), original_length)
        options = b"".join(_option(_OPT_COMMENT, comment.encode()) for comment in comments)
        options += _option(_EPB_FLAGS, struct.pack("=I", direction)) if direction else b""
        self._block(_ENHANCED_PACKET, head + _padded(frame) + _end(options))

    def _block(self, kind: int, body: bytes) -> None:
        length = struct.pack("=I", len(body) + 12)
        self._file.write(struct.pack("=I", kind) + length + body + length)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def _option(code: int, value: bytes) -> bytes:
    value = value[:0xFFFF]
    return struct.pack("=HH", code, len(value)) + _padded(value)


def _end(options: bytes) -> bytes:
    return options + bytes(4) if options else b""
