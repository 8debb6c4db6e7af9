"""The daemon's end of the mesh interface, the one that the node's programs see: a TAP, or where there is none a veth.

Of a veth pair the programs' end has the mesh interface's name, and ours that name with ``-io`` behind it; who may make
interfaces makes the pair. Sources: linux/if_tun.h, netdevice(7).
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
import struct
from typing import Protocol

from wnet.io.packet_socket import PacketSocket, mac_of

TUN_DEVICE = "/dev/net/tun"
FAR_END_SUFFIX = "-io"
_TUNSETIFF = 0x400454CA
_IFF_TAP_NO_PI = 0x0002 | 0x1000
_SIOCGIFFLAGS, _SIOCSIFFLAGS, _SIOCSIFADDR, _SIOCSIFNETMASK, _SIOCSIFMTU = 0x8913, 0x8914, 0x8916, 0x891C, 0x8922
_IFF_UP = 0x1
_FRAME_BYTES_MAX = 65_536
_ETHERTYPE_ALL = 0x0003
_REFUSED = (errno.ENOENT, errno.EACCES, errno.EPERM, errno.ENODEV, errno.ENXIO)


class InterfaceDeleted(Exception):
    """The mesh interface is gone; nothing is left to route for."""


class MeshInterface(Protocol):
    """What the loop needs of it."""

    def fileno(self) -> int:
        """Readable when programs have sent something."""

    def read(self) -> bytes | None:
        """The next Ethernet frame that a program sent; None when there is none now.

        Raises:
            InterfaceDeleted: There will be none any more.
        """

    def write(self, frame: bytes) -> None:
        """Give the programs an Ethernet frame; lost where the interface is down."""

    def close(self) -> None:
        """Let go of it; a TAP that nobody keeps goes."""


class Tap:
    """See :class:`MeshInterface`."""

    def __init__(self, ifname: str) -> None:
        """Make the TAP, or take the free end of the one of that name.

        Raises:
            OSError: No TAP here, not permitted, or another process holds that end (EBUSY).
        """
        self._fd = os.open(TUN_DEVICE, os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            fcntl.ioctl(self._fd, _TUNSETIFF, struct.pack("16sH22x", ifname.encode(), _IFF_TAP_NO_PI))
        except BaseException:
            os.close(self._fd)
            raise

    def fileno(self) -> int:
        return self._fd

    def read(self) -> bytes | None:
        try:
            return os.read(self._fd, _FRAME_BYTES_MAX)
        except OSError as error:
            if error.errno == errno.EBADFD:
                raise InterfaceDeleted from None
            return None

    def write(self, frame: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._fd, frame)

    def close(self) -> None:
        os.close(self._fd)


class VethEnd(PacketSocket):
    """See :class:`MeshInterface`: the far end of a veth, whose near end is the mesh interface."""

    def __init__(self, ifname: str) -> None:
        super().__init__(ifname + FAR_END_SUFFIX, _ETHERTYPE_ALL)

    def read(self) -> bytes | None:
        frame = self.receive()
        if frame is None and self.is_deleted:
            raise InterfaceDeleted
        return frame

    def write(self, frame: bytes) -> None:
        with contextlib.suppress(OSError):
            self.send(frame)


def open_mesh_interface(ifname: str, address: str, mtu_bytes: int) -> tuple[MeshInterface, bytes]:
    """Take the daemon's end; returns it and the address of the interface that programs see.

    Args:
        ifname: Its name. An interface that is there keeps its settings.
        address: IPv4 with prefix length for an interface that is made here; empty for none.
        mtu_bytes: Of an interface that is made here.

    Raises:
        OSError: It cannot be had; the text says what to do.
    """
    if _exists(ifname + FAR_END_SUFFIX):
        return VethEnd(ifname), mac_of(ifname)
    is_new = not _exists(ifname)
    try:
        tap = Tap(ifname)
    except OSError as error:
        raise OSError(error.errno, _refusal(ifname, error)) from error
    try:
        if is_new:
            _furnish(ifname, address, mtu_bytes)
        return tap, mac_of(ifname)
    except BaseException:
        tap.close()
        raise


def _refusal(ifname: str, error: OSError) -> str:
    if error.errno == errno.EBUSY:
        return f"{ifname}: another process is its other end already; end that one or choose another name"
    if error.errno in _REFUSED:
        pair = f"ip link add {ifname} type veth peer name {ifname}{FAR_END_SUFFIX}"
        return f"{ifname}: {TUN_DEVICE}: {error.strerror}; get access to it, or make a veth instead: {pair}"
    return f"{ifname}: {error.strerror}"


def _exists(ifname: str) -> bool:
    try:
        socket.if_nametoindex(ifname)
    except OSError:
        return False
    return True


def _furnish(ifname: str, address: str, mtu_bytes: int) -> None:
    name = ifname.encode()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        fcntl.ioctl(sock, _SIOCSIFMTU, struct.pack("16si20x", name, mtu_bytes))
        if address:
            host, _, prefix = address.partition("/")
            mask = (0xFFFFFFFF << (32 - int(prefix or 32))) & 0xFFFFFFFF
            for order, value in ((_SIOCSIFADDR, socket.inet_aton(host)), (_SIOCSIFNETMASK, struct.pack("!I", mask))):
                fcntl.ioctl(sock, order, struct.pack("16sHxx4s16x", name, socket.AF_INET, value))
        (flags,) = struct.unpack_from("H", fcntl.ioctl(sock, _SIOCGIFFLAGS, struct.pack("16s24x", name)), 16)
        fcntl.ioctl(sock, _SIOCSIFFLAGS, struct.pack("16sH22x", name, flags | _IFF_UP))
