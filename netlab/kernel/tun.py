"""Taps: interfaces whose other end is a descriptor of a process. Sources: linux/if_tun.h, drivers/net/tun.c.

Imports no netlink library: processes of nodes use it.
"""

from __future__ import annotations

import fcntl
import os
import struct

DEVICE = "/dev/net/tun"
#: What a person does where it cannot be used.
REMEDY = f"ask the machine's administrator for access to {DEVICE}"

_TUNSETIFF = 0x400454CA
_TUNSETPERSIST = 0x400454CB
_IFF_TAP_NO_PI = 0x0002 | 0x1000
_IFREQ = struct.Struct("16sH22x")


def open_tap(ifname: str) -> int:
    """Make a tap in the calling thread's network namespace, or take the free end of the one of that name.

    The tap has a carrier from now until the descriptor is closed; with that it goes, unless :func:`keep` was called.

    Returns:
        A descriptor: each read gives, each write takes one Ethernet frame without its checksum.

    Raises:
        OSError: No tun in this kernel, not permitted, or somebody else holds that end (EBUSY).
    """
    fd = os.open(DEVICE, os.O_RDWR | os.O_CLOEXEC)
    try:
        fcntl.ioctl(fd, _TUNSETIFF, _IFREQ.pack(ifname.encode(), _IFF_TAP_NO_PI))
    except BaseException:
        os.close(fd)
        raise
    return fd


def keep(fd: int) -> None:
    """Have the interface stay, without carrier, when its descriptor is closed; it then goes with its namespace."""
    fcntl.ioctl(fd, _TUNSETPERSIST, 1)
