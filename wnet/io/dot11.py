"""Ethernet frames inside 802.11 data frames, as wnet sends them in monitor mode. Pure.

Source: IEEE 802.11-2016, 9.2.4 (header), 9.3.2.1 (ad hoc: receiver, sender, cell); RFC 1042 (SNAP). Frames are of no
network that a card has joined: the cell's address is wnet's own, locally administered.
"""

from __future__ import annotations

_DATA = b"\x08\x00\x00\x00"  # type data, no flags, no duration: group frames are not acknowledged
_DATA_MASK, _DATA_TYPE, _QOS, _NO_DATA = 0x0C, 0x08, 0x80, 0x40
_TO_FROM_PROTECTED = 0x43
_CELL = b"\x02WNET\x00"
_HEADER_BYTES = 24
_QOS_BYTES = 2
_SNAP = b"\xaa\xaa\x03\0\0\0"
_ETHERNET_ENDS_BYTES = 12
#: How much longer a frame is than the Ethernet frame in it.
EXTRA_BYTES = _HEADER_BYTES + len(_SNAP) - _ETHERNET_ENDS_BYTES


def encode(frame: bytes) -> bytes:
    """Put an Ethernet frame of at least 14 bytes into a data frame without checksum."""
    ends = frame[:_ETHERNET_ENDS_BYTES]
    return b"".join((_DATA, ends, _CELL, b"\0\0", _SNAP, frame[_ETHERNET_ENDS_BYTES:]))


def decode(data: bytes, start: int = 0) -> bytes | None:
    """Return the Ethernet frame in the 802.11 frame at ``start``; None for all that is not one between peers."""
    if len(data) < start + _HEADER_BYTES + len(_SNAP) + 2:
        return None
    kind = data[start]
    if kind & _DATA_MASK != _DATA_TYPE or kind & _NO_DATA or data[start + 1] & _TO_FROM_PROTECTED:
        return None
    body = start + _HEADER_BYTES + (_QOS_BYTES if kind & _QOS else 0)
    if data[body : body + len(_SNAP)] != _SNAP:
        return None
    return data[start + 4 : start + 16] + data[body + len(_SNAP) :]
