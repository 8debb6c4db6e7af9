"""The medium's decision on one frame for one receiver, and its fixed-size record for the capture."""

from __future__ import annotations

import struct
from enum import IntEnum


class Verdict(IntEnum):
    """Why a frame reached a receiver or did not."""

    DELIVERED = 0
    LOST = 1  # the loss model
    QUEUE_FULL = 2  # the queue limit
    OUTAGE = 3  # a silent outage or an administrative cut
    OUT_OF_RANGE = 4
    CORRUPTED = 5  # delivered with a flipped bit
    DUPLICATED = 6  # the extra copy, delivered
    REORDERED = 7  # delivered at once, ahead of delayed frames
    COLLISION = 8  # another transmission drowned it, or its receiver was transmitting


#: arrived_ns (CLOCK_REALTIME), departs_ns (0 when dropped), crc32 of the frame as sent, length in bytes,
#: sender port, receiver port, verdict, attempts and signal strength in dBm (0 and 0 where the medium has none, as on
#: wires). Little endian, 32 bytes.
VERDICT_RECORD = struct.Struct("<QQIIHHBBbx")
