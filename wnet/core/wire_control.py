"""HELLO, TC and acknowledgements as bytes (docs/wnet.md has every byte). Decoders never raise.

Attributes travel in one byte each: loss in 1/255, signal to noise in whole decibels, the rate on a logarithmic scale.
"""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx
from typing import NamedTuple

from wnet.core import wire
from wnet.core.events import Drop

FLAG_PARTIAL = 0x01
LINK_IS_USABLE, LINK_IS_MPR = 0x80, 0x40
_LINK_ID_MASK = 0x0F
_NO_SNR = -128
_UNTOLD = 255
MAX_LISTED = 16
"""Addresses, and groups, of one node that are told at most."""

# kind, flags, check, member, own and whole utilisation, node, epoch, sequence, interval (ms), digest
_HELLO = struct.Struct("!BBHBBB6sIHHI")
_HEARD = struct.Struct("!6sIBBBbBBbB")  # node, epoch, members, flags and id, loss, snr, rate in; loss, snr, rate out
_TC = struct.Struct("!6s6sHBB")  # all, node, check, utilisation, interval (s)
_LINK = struct.Struct("!6sBBbB")  # node, link id, loss, snr, rate
_ACK = struct.Struct("!BBHHI")  # kind, try of the newest, check, newest link sequence, bits of the 32 before it
_COUNT = struct.Struct("!H")
_HELLO_CHECK_AT, _TC_CHECK_AT, _ACK_CHECK_AT = 2, 12, 2
ACK_BYTES = _ACK.size
HEARD_BYTES = _HEARD.size
LINK_BYTES = _LINK.size


class Attributes(NamedTuple):
    """What one direction of a link is like. ``snr_db`` and ``rate_bps`` are None where nobody knows."""

    loss_ratio: float
    snr_db: float | None
    rate_bps: int | None


class NodeInfo(NamedTuple):
    """What a node tells of itself in HELLO and TC."""

    utilisation_ratio: float = 0.0
    addresses: tuple[bytes, ...] = ()
    groups: tuple[bytes, ...] = ()


class Heard(NamedTuple):
    """A link of HELLO's sender, from its member ``own_member`` to member ``peer_member`` of ``node``.

    ``incoming`` is its own measurement, ``outgoing`` what the neighbour told last, or None.
    """

    node: bytes
    epoch: int
    peer_member: int
    own_member: int
    link_id: int
    is_usable: bool
    is_mpr: bool
    incoming: Attributes
    outgoing: Attributes | None


class Hello(NamedTuple):
    """A HELLO. Partial ones leave links out, which says nothing about them. ``digest``: of all TCs that are held.

    ``own_utilisation_ratio``: the part of the time that the sender itself was sending; its node's, in ``info``, counts
    all that it hears.
    """

    node: bytes
    epoch: int
    member: int
    sequence: int
    interval_s: float
    digest: int
    own_utilisation_ratio: float
    is_partial: bool
    info: NodeInfo
    links: tuple[Heard, ...]


class Incoming(NamedTuple):
    """A usable link towards TC's origin, from ``node``."""

    node: bytes
    link_id: int
    attributes: Attributes


class Topology(NamedTuple):
    """What a TC says; epoch and sequence stand in the tail that carries it."""

    node: bytes
    interval_s: float
    info: NodeInfo
    links: tuple[Incoming, ...]


class Ack(NamedTuple):
    """Which link sequences arrived: ``newest``, by its try ``attempt``, and those of the 32 before it with a bit in
    ``bits`` (bit 0 is the one just before)."""

    newest: int
    attempt: int
    bits: int


def encode_hello(hello: Hello) -> bytes:
    """Return a HELLO's body."""
    interval_ms = min(round(hello.interval_s * 1000), 0xFFFF)
    flags = FLAG_PARTIAL if hello.is_partial else 0
    ratios = _from_ratio(hello.own_utilisation_ratio), _from_ratio(hello.info.utilisation_ratio)
    fixed = (hello.member, *ratios, hello.node, hello.epoch, hello.sequence, interval_ms, hello.digest)
    rest = _encode_info(hello.info) + _COUNT.pack(len(hello.links)) + b"".join(map(_encode_heard, hello.links))
    check = crc_hqx(rest, crc_hqx(_HELLO.pack(wire.HELLO, flags, 0, *fixed), 0))
    return _HELLO.pack(wire.HELLO, flags, check, *fixed) + rest


def _encode_heard(link: Heard) -> bytes:
    flags = link.link_id & _LINK_ID_MASK | LINK_IS_USABLE * link.is_usable | LINK_IS_MPR * link.is_mpr
    members = link.peer_member << 4 | link.own_member
    out = (_UNTOLD, _NO_SNR, 0) if link.outgoing is None else _from_attributes(link.outgoing)
    return _HEARD.pack(link.node, link.epoch, members, flags, *_from_attributes(link.incoming), *out)


def decode_hello(body: bytes) -> Hello | Drop:
    """Take a HELLO apart."""
    if len(body) < _HELLO.size:
        return Drop.TOO_SHORT
    _kind, flags, check, member, own, utilisation, node, epoch, sequence, interval_ms, digest = _HELLO.unpack_from(body)
    found = _decode_info(body, _HELLO.size, utilisation / 255)
    if found is None or found[1] + _COUNT.size > len(body) or member > 15:
        return Drop.MALFORMED
    info, at = found
    (count,) = _COUNT.unpack_from(body, at)
    at += _COUNT.size
    end = at + count * _HEARD.size
    if end > len(body):
        return Drop.MALFORMED
    if check != _check(body, _HELLO_CHECK_AT, end):
        return Drop.CHECK
    links = tuple(_decode_heard(body, i) for i in range(at, end, _HEARD.size))
    is_partial = bool(flags & FLAG_PARTIAL)
    return Hello(node, epoch, member, sequence, interval_ms / 1000, digest, own / 255, is_partial, info, links)


def _decode_heard(body: bytes, at: int) -> Heard:
    node, epoch, members, flags, loss, snr, rate, out_loss, out_snr, out_rate = _HEARD.unpack_from(body, at)
    return Heard(
        node,
        epoch,
        members >> 4,
        members & 15,
        flags & _LINK_ID_MASK,
        bool(flags & LINK_IS_USABLE),
        bool(flags & LINK_IS_MPR),
        _to_attributes(loss, snr, rate),
        None if out_loss == _UNTOLD else _to_attributes(out_loss, out_snr, out_rate),
    )


def encode_tc(topology: Topology) -> bytes:
    """Return what a TC carries in the place of an Ethernet frame; like one it begins with destination and source."""
    interval_s = min(max(round(topology.interval_s), 1), 255)
    fixed = (_from_ratio(topology.info.utilisation_ratio), interval_s)
    rest = _encode_info(topology.info) + _COUNT.pack(len(topology.links))
    for link in topology.links:
        rest += _LINK.pack(link.node, link.link_id, *_from_attributes(link.attributes))
    check = crc_hqx(rest, crc_hqx(_TC.pack(wire.BROADCAST, topology.node, 0, *fixed), 0))
    return _TC.pack(wire.BROADCAST, topology.node, check, *fixed) + rest


def decode_tc(inner: bytes) -> Topology | Drop:
    """Take what a TC carries apart."""
    if len(inner) < _TC.size:
        return Drop.TOO_SHORT
    _all, node, check, utilisation, interval_s = _TC.unpack_from(inner)
    found = _decode_info(inner, _TC.size, utilisation / 255)
    if found is None or found[1] + _COUNT.size > len(inner):
        return Drop.MALFORMED
    info, at = found
    (count,) = _COUNT.unpack_from(inner, at)
    at += _COUNT.size
    end = at + count * _LINK.size
    if end > len(inner):
        return Drop.MALFORMED
    if check != _check(inner, _TC_CHECK_AT, end):
        return Drop.CHECK
    links = []
    for i in range(at, end, _LINK.size):
        neighbour, link_id, loss, snr, rate = _LINK.unpack_from(inner, i)
        links.append(Incoming(neighbour, link_id, _to_attributes(loss, snr, rate)))
    return Topology(node, float(interval_s), info, tuple(links))


def encode_ack(ack: Ack) -> bytes:
    """Return an acknowledgement's body."""
    check = crc_hqx(_ACK.pack(wire.ACK, ack.attempt, 0, ack.newest, ack.bits), 0)
    return _ACK.pack(wire.ACK, ack.attempt, check, ack.newest, ack.bits)


def decode_ack(body: bytes) -> Ack | Drop:
    """Take an acknowledgement apart."""
    if len(body) < _ACK.size:
        return Drop.TOO_SHORT
    _kind, attempt, check, newest, bits = _ACK.unpack_from(body)
    if check != _check(body, _ACK_CHECK_AT, _ACK.size):
        return Drop.CHECK
    return Ack(newest, attempt, bits)


def _check(body: bytes, at: int, end: int) -> int:
    return crc_hqx(body[at + 2 : end], crc_hqx(body[:at] + b"\0\0", 0))


def _encode_info(info: NodeInfo) -> bytes:
    addresses, groups = info.addresses[:MAX_LISTED], info.groups[:MAX_LISTED]
    return bytes((len(addresses), len(groups))) + b"".join((*addresses, *groups))


def _decode_info(body: bytes, at: int, utilisation_ratio: float) -> tuple[NodeInfo, int] | None:
    if at + 2 > len(body):
        return None
    addresses, groups = body[at], body[at + 1]
    at += 2
    groups_at, end = at + 4 * addresses, at + 4 * addresses + 6 * groups
    if max(addresses, groups) > MAX_LISTED or end > len(body):
        return None
    return (
        NodeInfo(
            utilisation_ratio,
            tuple(body[i : i + 4] for i in range(at, groups_at, 4)),
            tuple(body[i : i + 6] for i in range(groups_at, end, 6)),
        ),
        end,
    )


def _from_ratio(ratio: float) -> int:
    return round(min(max(ratio, 0.0), 1.0) * 255)


def _from_attributes(attributes: Attributes) -> tuple[int, int, int]:
    loss = min(_from_ratio(attributes.loss_ratio), _UNTOLD - 1)
    snr = _NO_SNR if attributes.snr_db is None else min(max(round(attributes.snr_db), -127), 127)
    rate = 0 if not attributes.rate_bps else min(max(round(8 * math.log2(attributes.rate_bps / 1000)), 1), 255)
    return loss, snr, rate


def _to_attributes(loss: int, snr: int, rate: int) -> Attributes:
    """Return attributes as they are after a passage over the wire."""
    rate_bps = round(1000 * 2 ** (rate / 8)) if rate else None
    return Attributes(loss / 255, None if snr == _NO_SNR else float(snr), rate_bps)


def quantised(attributes: Attributes) -> Attributes:
    """Return attributes as others will read them, so that sender and receivers reckon with the same numbers."""
    return _to_attributes(*_from_attributes(attributes))
