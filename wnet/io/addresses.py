"""The IPv4 addresses of an interface. Source: rtnetlink(7), RTM_GETADDR."""

from __future__ import annotations

import socket
import struct

_RTM_GETADDR, _NLM_F_REQUEST_DUMP, _NLMSG_DONE = 22, 0x301, 3
_HEADER = struct.Struct("=IHHII")
_IFADDRMSG = struct.Struct("=BBBBi")  # family, prefix length, flags, scope, index
_ATTRIBUTE = struct.Struct("=HH")
_IFA_LOCAL = 2
_ANSWER_BYTES = 1 << 16


def addresses_of(ifname: str) -> tuple[bytes, ...]:
    """Return the addresses, of 4 bytes each; none where there is no such interface."""
    try:
        index = socket.if_nametoindex(ifname)
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.NETLINK_ROUTE) as sock:
            size = _HEADER.size + _IFADDRMSG.size
            order = _HEADER.pack(size, _RTM_GETADDR, _NLM_F_REQUEST_DUMP, 1, 0)
            sock.send(order + _IFADDRMSG.pack(socket.AF_INET, 0, 0, 0, 0))
            found: list[bytes] = []
            while _read(sock.recv(_ANSWER_BYTES), index, found):
                pass
            return tuple(found)
    except OSError:
        return ()


def _read(data: bytes, index: int, found: list[bytes]) -> bool:
    """Add the addresses in one answer; False at the end of the list."""
    at = 0
    while at + _HEADER.size <= len(data):
        length, kind, _, _, _ = _HEADER.unpack_from(data, at)
        if kind == _NLMSG_DONE or length < _HEADER.size + _IFADDRMSG.size:
            return False
        if _IFADDRMSG.unpack_from(data, at + _HEADER.size)[4] == index:
            found += _locals(data[at + _HEADER.size + _IFADDRMSG.size : at + length])
        at += (length + 3) & ~3
    return True


def _locals(attributes: bytes) -> list[bytes]:
    found = []
    at = 0
    while at + _ATTRIBUTE.size <= len(attributes):
        length, kind = _ATTRIBUTE.unpack_from(attributes, at)
        if kind == _IFA_LOCAL:
            found.append(attributes[at + _ATTRIBUTE.size : at + length])
        at += max(4, (length + 3) & ~3)
    return found
