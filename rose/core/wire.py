"""The frame that every rose datagram begins with. The only module of rose that packs bytes; docs/rose.md has the table.

======  =====  ==============================================================================================
offset  bytes  meaning (big endian)
======  =====  ==============================================================================================
0       2      magic, "RS"
2       1      version, 1
3       1      kind: 1 publication, 2 command, 3 answer, 4 announcement
4       1      flags: 1 sealed, 2 sliced (else the parts are cuts through the encoded message), 4 refused (answer)
5       1      key id; 0 if not sealed
6       2      part number, from 0
8       2      number of parts, from 1
10      16     host of the sender; IPv4 as ::ffff:a.b.c.d (RFC 4291, section 2.5.5.2)
26      2      robot of the sender
28      2      service of the sender
30      8      epoch: when the sender started, in ns since 1970 by its clock; a later start has a higher one
38      8      sequence number: of the publication, or of the command and its answer
46      8      when the message was published, in ns since 1970 by the sender's clock
54      4      type: the first four bytes of the SHA-256 of its name
58      1      version of the type
59      1      reserved, 0
60             the part's payload (MessagePack); sealed: encrypted, and 16 bytes of tag behind it
======  =====  ==============================================================================================
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag, StrEnum

from rose.core.addressing import ServiceId

MAGIC = b"RS"
VERSION = 1
_HEADER = struct.Struct("!2sBBBBHH20sQQQ4sBB")
HEADER_BYTES = _HEADER.size
TAG_BYTES = 16
#: How much longer sealing makes a datagram: its number since the sender's start, and the tag.
SEAL_BYTES = 8 + TAG_BYTES
#: What fits beside the headers of IPv6 and UDP into 1500 bytes.
DATAGRAM_BYTES_MAX = 1452
PARTS_MAX = 4096


class Kind(IntEnum):
    """What a datagram is."""

    PUBLICATION = 1
    COMMAND = 2
    ANSWER = 3
    ANNOUNCEMENT = 4


class Flag(IntFlag):
    """See the module's table."""

    SEALED = 1
    SLICED = 2
    REFUSED = 4


NO_FLAGS = Flag(0)


class Fault(StrEnum):
    """Why a datagram was not taken; the counters' names."""

    FOREIGN = "foreign"
    VERSION = "version"
    TRUNCATED = "truncated"
    MALFORMED = "malformed"
    UNSEALED = "unsealed"
    UNKNOWN_KEY = "unknown_key"
    FORGED = "forged"
    REPLAYED = "replayed"
    STALE = "stale"
    DUPLICATE = "duplicate"
    OTHER_TYPE = "other_type"
    UNDECODABLE = "undecodable"
    NOT_FOR_US = "not_for_us"


@dataclass(frozen=True, slots=True)
class Header:
    """A datagram's header. Times in nanoseconds since 1970 by the sender's clock; ``type_id`` has 4 bytes."""

    kind: Kind
    sender: ServiceId
    epoch_ns: int
    sequence: int
    published_ns: int
    type_id: bytes
    type_version: int
    flags: Flag = NO_FLAGS
    key_id: int = 0
    part: int = 0
    parts: int = 1


def encode(header: Header) -> bytes:
    """Return the header's ``HEADER_BYTES`` bytes."""
    return _HEADER.pack(
        MAGIC,
        VERSION,
        header.kind,
        header.flags,
        header.key_id,
        header.part,
        header.parts,
        header.sender.packed,
        header.epoch_ns,
        header.sequence,
        header.published_ns,
        header.type_id,
        header.type_version,
        0,
    )


def decode(datagram: bytes | memoryview) -> Header | Fault:
    """Read the header of a datagram. Never raises."""
    if len(datagram) < HEADER_BYTES:
        return Fault.FOREIGN if bytes(datagram[:2]) != MAGIC else Fault.TRUNCATED
    magic, version, kind, flags, key_id, part, parts, packed, *numbers = _HEADER.unpack_from(datagram)
    if magic != MAGIC:
        return Fault.FOREIGN
    if version != VERSION:
        return Fault.VERSION
    if not part < parts <= PARTS_MAX or flags & ~_KNOWN_FLAGS:
        return Fault.MALFORMED
    if flags & Flag.SEALED and len(datagram) < HEADER_BYTES + TAG_BYTES:
        return Fault.TRUNCATED
    epoch_ns, sequence, published_ns, type_id, type_version, _reserved = numbers
    try:
        sender, word = ServiceId.unpack(packed), Kind(kind)
    except ValueError:  # AddressError is one
        return Fault.MALFORMED
    return Header(
        word, sender, epoch_ns, sequence, published_ns, type_id, type_version, Flag(flags), key_id, part, parts
    )


_KNOWN_FLAGS = int(Flag.SEALED | Flag.SLICED | Flag.REFUSED)
