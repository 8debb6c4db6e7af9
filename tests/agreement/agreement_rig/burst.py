"""Many frames, each out of another interface, in one system call: sendmmsg(2) on a packet socket, by ctypes."""

from __future__ import annotations

import ctypes
import os
import socket
import struct
from collections.abc import Sequence

from agreement_rig.lab import NUMBER, NUMBER_AT

_SOCKADDR_LL = struct.Struct("=HHiHBB8s")


class _IoVec(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _MsgHdr(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint),
        ("iov", ctypes.POINTER(_IoVec)),
        ("iov_length", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _MMsgHdr(ctypes.Structure):
    _fields_ = (("header", _MsgHdr), ("sent", ctypes.c_uint))


_libc = ctypes.CDLL(None, use_errno=True)
_libc.sendmmsg.argtypes = (ctypes.c_int, ctypes.POINTER(_MMsgHdr), ctypes.c_uint, ctypes.c_int)


class Burst:
    """The sender of all cells: frame ``i`` of a burst leaves by interface ``i``. Made inside the sender's namespace."""

    def __init__(self, frames: Sequence[bytes], interfaces: Sequence[str]) -> None:
        """``frames[i]`` is any numbered frame of the ``i``-th sender."""
        self._sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
        self._frames = [ctypes.create_string_buffer(frame, len(frame)) for frame in frames]
        self._names = [ctypes.create_string_buffer(_address(name), _SOCKADDR_LL.size) for name in interfaces]
        self._vectors = [_IoVec(ctypes.addressof(frame), len(frame)) for frame in self._frames]
        self._messages = (_MMsgHdr * len(frames))(*map(self._message, range(len(frames))))

    def send(self, number: int, count: int) -> None:
        """Send frame ``number`` of the first ``count`` senders.

        Raises:
            OSError: The kernel refuses one of them.
        """
        numbers = NUMBER.pack(number, number, number)
        for frame in self._frames[:count]:
            ctypes.memmove(ctypes.addressof(frame) + NUMBER_AT, numbers, len(numbers))
        sent = _libc.sendmmsg(self._sock.fileno(), self._messages, count, 0)
        if sent != count:
            number = ctypes.get_errno() if sent < 0 else 0
            raise OSError(number, f"{sent} of {count} frames sent: {os.strerror(number)}")

    def close(self) -> None:
        """Close the socket."""
        self._sock.close()

    def _message(self, index: int) -> _MMsgHdr:
        header = _MsgHdr(
            ctypes.addressof(self._names[index]), _SOCKADDR_LL.size, ctypes.pointer(self._vectors[index]), 1, None, 0, 0
        )
        return _MMsgHdr(header, 0)


def _address(interface: str) -> bytes:
    return _SOCKADDR_LL.pack(socket.AF_PACKET, 0, socket.if_nametoindex(interface), 0, 0, 6, bytes(8))
