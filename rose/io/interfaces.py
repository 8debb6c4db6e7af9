"""Which interface has an address, asked of the kernel afresh: interfaces come and go under a running service."""

from __future__ import annotations

import fcntl
import socket
import struct
from array import array
from ipaddress import IPv4Address
from pathlib import Path

from rose.core.addressing import Host

_SIOCGIFCONF = 0x8912
_IFREQ_BYTES = 40
_ADDRESSES_MAX = 1024


def interface_of(host: Host) -> int | None:
    """Return the index of the interface that has an address; None if none has it now."""
    if host.is_loopback:
        return socket.if_nametoindex("lo")
    return _with_ipv4(host) if isinstance(host, IPv4Address) else _with_ipv6(host.packed)


def _with_ipv4(host: IPv4Address) -> int | None:
    """netdevice(7): SIOCGIFCONF lists every IPv4 address, further ones of an interface too, up or down."""
    found = array("B", bytes(_ADDRESSES_MAX * _IFREQ_BYTES))
    request = struct.pack("iP", len(found), found.buffer_info()[0])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        length_bytes = struct.unpack_from("i", fcntl.ioctl(sock, _SIOCGIFCONF, request))[0]
    for at in range(0, length_bytes, _IFREQ_BYTES):
        label, address = struct.unpack_from("16s4x4s", found, at)
        if address == host.packed:
            name = label.partition(b"\0")[0].partition(b":")[0]
            try:
                return socket.if_nametoindex(name.decode())
            except OSError:  # gone in between
                return None
    return None


def _with_ipv6(packed: bytes) -> int | None:
    """proc(5), /proc/net/if_inet6: address, index, prefix length, scope, flags, name; all in hexadecimal."""
    try:
        lines = Path("/proc/net/if_inet6").read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        address, index, *_rest = line.split()
        if bytes.fromhex(address) == packed:
            return int(index, 16)
    return None
