"""A raw packet socket on one interface, which stays usable when the interface goes down and comes back. See packet(7).

Send buffers are small: what does not leave at once is to wait in the mesh, where urgent frames pass the others.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import socket
import struct

_SOL_PACKET = 263
_PACKET_IGNORE_OUTGOING = 23
_SO_RCVBUFFORCE = 33
_SO_ATTACH_FILTER = 26
_INSTRUCTION_BYTES = 8
_RECEIVE_BUFFER_BYTES = 4 << 20
#: The kernel doubles it, and counts some 2.3 kB for a whole frame: a handful.
_SEND_BUFFER_BYTES = 16 << 10
_FRAME_BYTES_MAX = 65_536
_SIOCGIFMTU = 0x8921


class PacketSocket:
    """Receives what others send to the interface with one EtherType (3: any), and sends whole frames."""

    def __init__(self, ifname: str, ethertype: int) -> None:
        """Receives at once.

        Raises:
            OSError: No such interface, or packet sockets are not permitted.
        """
        self.ifname = ifname
        self.is_deleted = False
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW | socket.SOCK_CLOEXEC, 0)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
            try:  # past the limit that is for those without the right
                self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER_BYTES)
            except OSError:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
            with contextlib.suppress(OSError):  # kernels before 4.20 show what we send; it is told by its sender
                self._socket.setsockopt(_SOL_PACKET, _PACKET_IGNORE_OUTGOING, 1)
            self._socket.bind((ifname, ethertype))
        except BaseException:
            self._socket.close()
            raise
        self._receive = self._socket.recv
        self.send = self._socket.send

    @property
    def mac(self) -> bytes:
        """The interface's address."""
        mac: bytes = self._socket.getsockname()[4]
        return mac

    @property
    def hardware_type(self) -> int:
        """Its ARPHRD number."""
        kind: int = self._socket.getsockname()[3]
        return kind

    @property
    def mtu_bytes(self) -> int:
        """Its MTU."""
        answer = fcntl.ioctl(self._socket, _SIOCGIFMTU, struct.pack("16si20x", self.ifname.encode(), 0))
        mtu: int = struct.unpack_from("i", answer, 16)[0]
        return mtu

    def fileno(self) -> int:
        """Readable when frames wait."""
        return self._socket.fileno()

    def receive(self) -> bytes | None:
        """The next frame; None when there is none now, also because the interface has just gone down or away."""
        try:
            return self._receive(_FRAME_BYTES_MAX)
        except OSError as error:
            self.is_deleted = error.errno in (errno.ENODEV, errno.ENXIO)
            return None

    def attach_filter(self, program: bytes) -> None:
        """Have the kernel drop what a classic BPF program does not accept; see linux/filter.h."""
        code = ctypes.create_string_buffer(program, len(program))
        # struct sock_fprog: instruction count, padding, pointer
        order = struct.pack("@HP", len(program) // _INSTRUCTION_BYTES, ctypes.addressof(code))
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, order)

    def close(self) -> None:
        """Stop."""
        self._socket.close()


def mac_of(ifname: str) -> bytes:
    """Address of an interface; 6 bytes.

    Raises:
        OSError: There is none of that name.
    """
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as sock:
        sock.bind((ifname, 0))
        mac: bytes = sock.getsockname()[4]
        return mac
