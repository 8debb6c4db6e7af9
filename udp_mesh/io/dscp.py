"""How priorities are marked in the IP header, so that radios and switches on the way honour them, too.

Source of the code points: RFC 4594 (EF, AF41, CS1); Linux's mac80211 puts their upper three bits into Wi-Fi's access
categories, so that EF and AF41 contend as video or voice and CS1 as background.
"""

from __future__ import annotations

EXPEDITED, ASSURED, BEST_EFFORT, BACKGROUND = 46, 34, 0, 8
_UP_TO = ((1, EXPEDITED), (3, ASSURED), (6, BEST_EFFORT))


def dscp_of(priority: int) -> int:
    """Return the code point, 0..63, of a message priority, 0..255; the default priority is best effort."""
    return next((code for highest, code in _UP_TO if priority <= highest), BACKGROUND)


def tos_of(priority: int) -> int:
    """Return the byte of the IP header with this code point; the two bits for congestion marks are 0."""
    return dscp_of(priority) << 2
