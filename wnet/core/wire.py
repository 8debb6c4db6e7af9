"""Frames of data as bytes: what stands between a member's Ethernet header and the frame that travels inside.

docs/wnet.md has every byte. HELLO, TC and acknowledgements are :mod:`wnet.core.wire_control`'s. Decoders never raise:
they return a :class:`~wnet.core.events.Drop`. A *body* is a frame without its outer Ethernet header.

A body of data is ``head, list, tail``. The head (and the list) is written anew by every hop; the tail, which holds
epoch and sequence number of the source and the frame inside, travels unchanged. Its first 20 bytes tell it from all
others: :func:`key_of`.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Sequence
from typing import NamedTuple

from wnet.core.events import Drop

#: Local Experimental EtherType 2 (IEEE 802, clause 9.2.3).
ETHERTYPE = b"\x88\xb6"
ETHERNET_BYTES = 14
BROADCAST = b"\xff" * 6
#: Frames for several neighbours go to this group, so that other stations need not look at them.
GROUP = bytes.fromhex("03574e657400")

_VERSION = 1 << 4
HELLO, ACK, PROBE, UNICAST, MULTICAST, ROUTED, FLOOD, TC, AGGREGATE, SEALED = (_VERSION | kind for kind in range(1, 11))
KINDS = frozenset(range(HELLO, SEALED + 1))
AGGREGATE_HEAD = bytes((AGGREGATE,))

#: A TC's head tells in the place of the link sequence how old it is, in this unit.
AGE_UNIT_S = 0.1

FLAG_ACK = 0x01
_TRY_SHIFT = 1
_TRY_MASK = 0x07
MAX_TRY = 7

_HEAD = struct.Struct("!BBBBHHH")  # kind, flags, hop limit, urgency, check, length of the frame inside, link sequence
HEAD_BYTES = _HEAD.size
_CHECK_AT = 4
_ORIGIN = struct.Struct("!II")
ORIGIN_BYTES = _ORIGIN.size
HEADER_BYTES = HEAD_BYTES + ORIGIN_BYTES
KEY_BYTES = ORIGIN_BYTES + 12
_MAC_BYTES = 6
_HOP = struct.Struct("!6sHB")  # member of the next hop, link sequence, number of destinations
_RELAY = struct.Struct("!6sH")  # member of the multipoint relay, link sequence


class Hop(NamedTuple):
    """What one next hop shall do: forward to ``destinations`` (nodes), none of them in a flood."""

    peer_mac: bytes
    sequence: int
    destinations: tuple[bytes, ...]


class Data(NamedTuple):
    """A body of data, taken apart. ``hops`` is empty for UNICAST and ROUTED, which say ``sequence`` in the head.

    ``route``: the nodes that are left to pass, of ROUTED only, this node first.
    """

    kind: int
    is_ack_wanted: bool
    attempt: int
    hop_limit: int
    urgency: int
    sequence: int
    hops: tuple[Hop, ...]
    route: tuple[bytes, ...]
    tail: bytes


def tail_of(epoch: int, sequence: int, inner: bytes) -> bytes:
    """Return the part of a body that no hop changes."""
    return _ORIGIN.pack(epoch, sequence) + inner


def key_of(tail: bytes) -> bytes:
    """Return what tells a frame from all others: epoch, sequence, destination and source."""
    return tail[:KEY_BYTES]


def destination_of(tail: bytes) -> bytes:
    """Return the destination address of the frame inside."""
    return tail[ORIGIN_BYTES : ORIGIN_BYTES + _MAC_BYTES]


def source_of(tail: bytes) -> bytes:
    """Return the source address of the frame inside, its node."""
    return tail[ORIGIN_BYTES + _MAC_BYTES : KEY_BYTES]


def origin_of(tail: bytes) -> tuple[int, int]:
    """Return epoch and sequence number of the source."""
    return _ORIGIN.unpack_from(tail)


def inner_of(tail: bytes) -> bytes:
    """Return the Ethernet frame inside."""
    return tail[ORIGIN_BYTES:]


def encode(
    kind: int,
    tail: bytes,
    *,
    is_ack_wanted: bool,
    attempt: int,
    hop_limit: int,
    urgency: int,
    sequence: int = 0,
    listing: bytes = b"",
) -> bytes:
    """Return a body; ``listing`` is what one of the functions below made."""
    flags = is_ack_wanted | attempt << _TRY_SHIFT
    length = max(len(tail) - ORIGIN_BYTES, 0)
    unchecked = _HEAD.pack(kind, flags, hop_limit, urgency, 0, length, sequence)
    check = crc_hqx(tail[:KEY_BYTES], crc_hqx(listing, crc_hqx(unchecked, 0)) if listing else crc_hqx(unchecked, 0))
    return b"".join((_HEAD.pack(kind, flags, hop_limit, urgency, check, length, sequence), listing, tail))


def forward_list(hops: Sequence[Hop]) -> bytes:
    """Return the list of MULTICAST."""
    parts = [bytes((len(hops),))]
    for hop in hops:
        parts += (_HOP.pack(hop.peer_mac, hop.sequence, len(hop.destinations)), *hop.destinations)
    return b"".join(parts)


def forward_list_bytes(destinations: Sequence[int]) -> int:
    """Return the length of a forward list whose hops have so many destinations each."""
    return 1 + len(destinations) * _HOP.size + sum(destinations) * _MAC_BYTES


def relay_list(hops: Sequence[Hop]) -> bytes:
    """Return the MPR list of FLOOD and TC."""
    return bytes((len(hops),)) + b"".join(_RELAY.pack(hop.peer_mac, hop.sequence) for hop in hops)


def relay_list_bytes(count: int) -> int:
    """Return the length of a list of so many multipoint relays."""
    return 1 + count * _RELAY.size


def route_list(nodes: Sequence[bytes]) -> bytes:
    """Return the list of ROUTED: the nodes to pass, the destination last."""
    return bytes((len(nodes),)) + b"".join(nodes)


def decode(body: bytes) -> Data | Drop:
    """Take a body of data or a probe apart. Never raises."""
    if len(body) < HEAD_BYTES:
        return Drop.TOO_SHORT
    kind, flags, hop_limit, urgency, check, length, sequence = _HEAD.unpack_from(body)
    hops: tuple[Hop, ...] = ()
    route: tuple[bytes, ...] = ()
    at = HEAD_BYTES
    if kind not in (UNICAST, PROBE):
        listed = _decode_list(kind, body)
        if listed is None:
            return Drop.MALFORMED
        hops, route, at = listed
    end = at + ORIGIN_BYTES + length if kind != PROBE else at
    if len(body) < end or (kind != PROBE and length < ETHERNET_BYTES):
        return Drop.MALFORMED
    found = crc_hqx(body[:_CHECK_AT] + b"\0\0" + body[_CHECK_AT + 2 : min(at + KEY_BYTES, end)], 0)
    if check != found:
        return Drop.CHECK
    attempt = flags >> _TRY_SHIFT & _TRY_MASK
    return Data(kind, bool(flags & FLAG_ACK), attempt, hop_limit, urgency, sequence, hops, route, body[at:end])


def _decode_list(kind: int, body: bytes) -> tuple[tuple[Hop, ...], tuple[bytes, ...], int] | None:
    if len(body) <= HEAD_BYTES:
        return None
    count, at = body[HEAD_BYTES], HEAD_BYTES + 1
    if kind == ROUTED:
        end = at + count * _MAC_BYTES
        return None if end > len(body) else ((), _macs(body, at, count), end)
    hops: list[Hop] = []
    for _ in range(count):
        if kind == MULTICAST:
            if at + _HOP.size > len(body):
                return None
            peer_mac, sequence, destinations = _HOP.unpack_from(body, at)
            at += _HOP.size
            if at + destinations * _MAC_BYTES > len(body):
                return None
            hops.append(Hop(peer_mac, sequence, _macs(body, at, destinations)))
            at += destinations * _MAC_BYTES
        else:
            if at + _RELAY.size > len(body):
                return None
            peer_mac, sequence = _RELAY.unpack_from(body, at)
            hops.append(Hop(peer_mac, sequence, ()))
            at += _RELAY.size
    return tuple(hops), (), at


def _macs(body: bytes, at: int, count: int) -> tuple[bytes, ...]:
    return tuple(body[i : i + _MAC_BYTES] for i in range(at, at + count * _MAC_BYTES, _MAC_BYTES))


_AGGREGATED = struct.Struct("!H")
AGGREGATED_BYTES = _AGGREGATED.size


def aggregate(bodies: Sequence[bytes]) -> bytes:
    """Return one body that holds several, each preceded by its length; 1 + 2 bytes each longer than these."""
    parts = [bytes((AGGREGATE,))]
    for body in bodies:
        parts += (_AGGREGATED.pack(len(body)), body)
    return b"".join(parts)


def split(body: bytes) -> list[bytes] | Drop:
    """Return the bodies of an aggregate; a length of 0, as in Ethernet's padding, ends it. Never raises."""
    bodies: list[bytes] = []
    at = 1
    while at + _AGGREGATED.size <= len(body):
        (length,) = _AGGREGATED.unpack_from(body, at)
        at += _AGGREGATED.size
        if length == 0:
            break
        if at + length > len(body) or body[at] in (AGGREGATE, SEALED):
            return Drop.MALFORMED
        bodies.append(body[at : at + length])
        at += length
    return bodies
