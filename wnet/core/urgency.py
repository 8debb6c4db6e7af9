"""How urgent a frame is, by the DSCP of the IP packet in it: 1 is the most urgent data, 7 the least; 0 is control's.

Classes are the upper three bits of the DSCP, as Wi-Fi's user priorities are (RFC 8325, section 2.3), with what is meant
to come last there (CS1, and LE of RFC 8622) last here, too.
"""

from __future__ import annotations

_ARP, _IPV4, _IPV6 = b"\x08\x06", b"\x08\x00", b"\x86\xdd"
_BY_CLASS = (6, 7, 5, 4, 3, 2, 1, 1)  # of CS0 to CS7
_LOWER_EFFORT = 1
_ASSURED_1 = (10, 12, 14)
BEST_EFFORT = 6
_WITHOUT_IP = 3
"""ARP and the like: everything else waits for it."""


def urgency_of_dscp(dscp: int) -> int:
    """Return the class, 1..7, of a DSCP, 0..63."""
    if dscp == _LOWER_EFFORT:
        return 7
    if dscp in _ASSURED_1:
        return BEST_EFFORT
    return _BY_CLASS[dscp >> 3]


_BY_DSCP = tuple(urgency_of_dscp(dscp) for dscp in range(64))


def urgency_of(inner: bytes) -> int:
    """Return the class of an Ethernet frame."""
    ethertype = inner[12:14]
    if ethertype == _IPV4 and len(inner) > 15:
        return _BY_DSCP[inner[15] >> 2]
    if ethertype == _IPV6 and len(inner) > 15:
        return _BY_DSCP[(inner[14] & 0x0F) << 2 | inner[15] >> 6]
    return _WITHOUT_IP
