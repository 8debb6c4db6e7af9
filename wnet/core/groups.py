"""Multicast groups that this node listens to, read from its own IGMP and MLD, and the queries that keep them fresh.

Memberships are kept by IP address and told as multicast MAC addresses (RFC 1112, section 6.4; RFC 2464, section 7). The
mesh is the querier: it asks its own host every 30 s, so that it also learns what was joined before it ran, and forgets
what is not told again. Sources (IGMPv3, MLDv2) are not distinguished. Reports go no further than here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from wnet.core.wire_control import MAX_LISTED

QUERY_INTERVAL_S = 30.0
_FIRST_QUERY_S = 0.2
_HOLD_S = 2.5 * QUERY_INTERVAL_S
_MAX_GROUPS = 256
_IPV4, _IPV6 = b"\x08\x00", b"\x86\xdd"
_IGMP, _HOP_BY_HOP, _ICMPV6 = 2, 0, 58
_IGMP_REPORTS, _IGMP_LEAVE, _IGMP_REPORT_3 = (0x12, 0x16), 0x17, 0x22
_MLD_REPORT, _MLD_DONE, _MLD_REPORT_2 = 131, 132, 143
_TO_INCLUDE, _IS_INCLUDE = 3, 1
_BLOCK = 6
ALL_HOSTS = (bytes.fromhex("01005e000001"), bytes.fromhex("333300000001"))
"""Groups of every host: nobody reports them, frames to them go to all."""
_RECORD_HEAD = struct.Struct("!BBH")


class Membership(NamedTuple):
    """One thing that a report says: ``group`` is an IP address of 4 or 16 bytes."""

    group: bytes
    is_joined: bool


def is_ip_group(mac: bytes) -> bool:
    """Whether a multicast MAC address stands for IP groups, whose listeners report them."""
    return mac[:3] == b"\x01\x00\x5e" or mac[:2] == b"\x33\x33"


def mac_of(group: bytes) -> bytes:
    """Return the MAC address of an IP multicast group."""
    if len(group) == 4:
        return b"\x01\x00\x5e" + bytes((group[1] & 0x7F,)) + group[2:]
    return b"\x33\x33" + group[12:]


def read(inner: bytes) -> list[Membership] | None:
    """Return what a report or leave in an Ethernet frame says, None if the frame is none. Never raises."""
    if inner[12:14] == _IPV4:
        return _read_ipv4(inner)
    if inner[12:14] == _IPV6:
        return _read_ipv6(inner)
    return None


def _read_ipv4(inner: bytes) -> list[Membership] | None:
    if len(inner) < 34 or inner[23] != _IGMP:
        return None
    message = inner[14 + 4 * (inner[14] & 0x0F) :]
    if len(message) < 8:
        return None
    if message[0] in _IGMP_REPORTS or message[0] == _IGMP_LEAVE:
        return [Membership(message[4:8], message[0] != _IGMP_LEAVE)]
    return list(_records(message, 4)) if message[0] == _IGMP_REPORT_3 else None


def _read_ipv6(inner: bytes) -> list[Membership] | None:
    if len(inner) < 56 or inner[20] != _HOP_BY_HOP or inner[54] != _ICMPV6:
        return None
    message = inner[54 + 8 * (inner[55] + 1) :]
    if len(message) < 8:
        return None
    if message[0] in (_MLD_REPORT, _MLD_DONE) and len(message) >= 24:
        return [Membership(message[8:24], message[0] == _MLD_REPORT)]
    return list(_records(message, 16)) if message[0] == _MLD_REPORT_2 else None


def _records(message: bytes, address_bytes: int) -> Iterator[Membership]:
    """Yield the records of an IGMPv3 (RFC 3376, 4.2) or MLDv2 report (RFC 3810, 5.2)."""
    (count,) = struct.unpack_from("!H", message, 6)
    at = 8
    for _ in range(count):
        if at + _RECORD_HEAD.size + address_bytes > len(message):
            return
        kind, auxiliary_words, sources = _RECORD_HEAD.unpack_from(message, at)
        at += _RECORD_HEAD.size
        group = message[at : at + address_bytes]
        at += address_bytes * (1 + sources) + 4 * auxiliary_words
        if kind != _BLOCK:
            yield Membership(group, sources > 0 or kind not in (_TO_INCLUDE, _IS_INCLUDE))


class Groups:
    """The groups of one node."""

    def __init__(self, mac: bytes, *, now: float) -> None:
        self._mac = mac
        self._held: dict[bytes, float] = {}
        self._query_due = now + _FIRST_QUERY_S

    @property
    def macs(self) -> tuple[bytes, ...]:
        """The groups as MAC addresses; others than those of every host, at most 16."""
        return tuple(sorted({mac_of(group) for group in self._held} - set(ALL_HOSTS)))[:MAX_LISTED]

    def take(self, memberships: list[Membership], *, now: float) -> None:
        """Take what a report says."""
        for group, is_joined in memberships:
            if not is_joined:
                self._held.pop(group, None)
            elif group in self._held or len(self._held) < _MAX_GROUPS:
                self._held[group] = now + _HOLD_S

    def next_due(self) -> float:
        """When the next query is due."""
        return self._query_due

    def handle(self, *, now: float) -> list[bytes]:
        """Forget what is not told any more; return the queries for this node's host."""
        self._query_due = now + QUERY_INTERVAL_S
        for group in [group for group, expires in self._held.items() if expires <= now]:
            del self._held[group]
        return [igmp_query(self._mac), mld_query(self._mac)]


def igmp_query(mac: bytes) -> bytes:
    """Return a general query (RFC 3376, 4.1) for the host whose interface has ``mac``, within one second."""
    igmp = struct.pack("!BBH4sBBH", 0x11, 10, 0, bytes(4), 2, int(QUERY_INTERVAL_S), 0)
    igmp = igmp[:2] + _checksum(igmp) + igmp[4:]
    ip = (
        struct.pack("!BBHHHBBH4s4s", 0x46, 0xC0, 24 + len(igmp), 0, 0, 1, _IGMP, 0, bytes(4), b"\xe0\0\0\1")
        + b"\x94\4\0\0"
    )
    ip = ip[:10] + _checksum(ip) + ip[12:]
    return ALL_HOSTS[0] + _querier(mac) + _IPV4 + ip + igmp


def mld_query(mac: bytes) -> bytes:
    """Return a general query (RFC 3810, 5.1) for the host whose interface has ``mac``, within one second."""
    source_mac = _querier(mac)
    source = b"\xfe\x80" + bytes(6) + bytes((source_mac[0] ^ 2,)) + source_mac[1:3] + b"\xff\xfe" + source_mac[3:]
    destination = b"\xff\2" + bytes(13) + b"\1"
    mld = struct.pack("!BBHHH16sBBH", 130, 0, 0, 1000, 0, bytes(16), 2, int(QUERY_INTERVAL_S), 0)
    pseudo = source + destination + struct.pack("!II", len(mld), _ICMPV6)
    mld = mld[:2] + _checksum(pseudo + mld) + mld[4:]
    options = bytes((_ICMPV6, 0, 5, 2, 0, 0, 1, 0))  # router alert: MLD (RFC 2711), padding
    ip = struct.pack("!IHBB16s16s", 0x60000000, len(options) + len(mld), _HOP_BY_HOP, 1, source, destination)
    return ALL_HOSTS[1] + source_mac + _IPV6 + ip + options + mld


def _querier(mac: bytes) -> bytes:
    """Return an address that no node has: the host would not believe a query from its own."""
    return bytes((mac[0] | 2, *mac[1:5], mac[5] ^ 0x80))


def _checksum(data: bytes) -> bytes:
    """Return the Internet checksum (RFC 1071)."""
    total = sum(struct.unpack(f"!{len(data) // 2}H", data[: len(data) // 2 * 2])) + (
        data[-1] << 8 if len(data) % 2 else 0
    )
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return struct.pack("!H", ~total & 0xFFFF)
