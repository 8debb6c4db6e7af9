"""What of an 802.11 frame the lab looks at, and the Ethernet frame that the interface above sees. Pure.

Source: IEEE 802.11-2016, 9.2.4 (header), 9.3.2.1 (addresses of data frames), 9.2.4.7.3 (mesh control).
"""

from __future__ import annotations

_TYPE_DATA = 2
_TO_DS, _FROM_DS, _PROTECTED, _ORDER = 0x01, 0x02, 0x40, 0x80
_SUBTYPE_QOS, _SUBTYPE_NO_DATA = 0x8, 0x4
_QOS_MESH_CONTROL = 0x01  # bit 8 of the QoS control field
_MESH_CONTROL_BYTES = 6
_SNAP = b"\xaa\xaa\x03\0\0\0"
SHORTEST_BYTES = 10  # frame control, duration, receiver


def ethernet_of(frame: bytes) -> bytes | None:
    """Return the Ethernet frame that an 802.11 data frame carries, as the interface of its first sender had it.

    None for anything else: management, control, encrypted, empty or cut frames.
    """
    if len(frame) < 24 or (frame[0] >> 2) & 3 != _TYPE_DATA:
        return None
    subtype, flags = frame[0] >> 4, frame[1]
    if subtype & _SUBTYPE_NO_DATA or flags & _PROTECTED:
        return None
    four = flags & _TO_DS and flags & _FROM_DS
    start = 30 if four else 24
    destination, source = _ends(frame, flags)
    if subtype & _SUBTYPE_QOS:
        mesh = len(frame) > start + 1 and frame[start + 1] & _QOS_MESH_CONTROL
        start += 6 if flags & _ORDER else 2
        if mesh and len(frame) > start:
            extra = frame[start] & 3  # addresses that the mesh control adds
            more = frame[start + _MESH_CONTROL_BYTES : start + _MESH_CONTROL_BYTES + 6 * extra]
            start += _MESH_CONTROL_BYTES + len(more)
            if extra == 1:
                source = more[:6]
            elif extra == 2:
                destination, source = more[:6], more[6:12]
    if frame[start : start + len(_SNAP)] != _SNAP:
        return None
    return destination + source + frame[start + len(_SNAP) :]


def _ends(frame: bytes, flags: int) -> tuple[bytes, bytes]:
    first, second, third = frame[4:10], frame[10:16], frame[16:22]
    if flags & _TO_DS:
        return third, (frame[24:30] if flags & _FROM_DS else second)
    return first, (third if flags & _FROM_DS else second)
