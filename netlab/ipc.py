"""Messages with file descriptors between the lab's own processes, over one connected stream socket.

Both ends run the same code and trust each other (a parent and the child that it started): messages are pickled.
Never use it on a socket that somebody else can open; the control socket speaks JSON.
"""

from __future__ import annotations

import array
import os
import pickle
import socket
import struct
import sys
from collections.abc import Sequence
from typing import Any

_HEADER = struct.Struct("<IH")  # length of the pickled message, number of file descriptors that come with it
_CHILD_FD = 3
MAX_FDS = 250  # the kernel's SCM_MAX_FD is 253


class Channel:
    """One end of a pair; blocking. ``fileno()`` lets a selector wait for the next message."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock

    @classmethod
    def pair(cls) -> tuple[Channel, Channel]:
        """Return two connected ends; the second is meant for a child process."""
        a, b = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        return cls(a), cls(b)

    @classmethod
    def from_fd(cls, fd: int) -> Channel:
        """Adopt an inherited file descriptor."""
        return cls(socket.socket(fileno=fd))

    def fileno(self) -> int:
        """The socket's descriptor."""
        return self._sock.fileno()

    def send(self, message: Any, fds: Sequence[int] = ()) -> None:
        """Send one message and duplicates of ``fds``.

        Raises:
            ValueError: More than ``MAX_FDS`` descriptors.
            OSError: The other end is gone (BrokenPipeError) or the socket failed.
        """
        if len(fds) > MAX_FDS:
            raise ValueError(f"{len(fds)} file descriptors in one message; at most {MAX_FDS}")
        body = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
        header = _HEADER.pack(len(body), len(fds))
        # The descriptors ride on the header's bytes; a stream socket never merges data across such a boundary.
        ancillary = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", fds))] if fds else []
        sent = self._sock.sendmsg([header], ancillary)
        self._sock.sendall(header[sent:] + body)

    def recv(self) -> tuple[Any, list[int]]:
        """Return the next message and the descriptors that came with it (now owned by the caller).

        Raises:
            EOFError: The other end closed.
        """
        received: array.array[int] = array.array("i")
        space = socket.CMSG_LEN(MAX_FDS * received.itemsize)
        header, ancillary, _flags, _address = self._sock.recvmsg(_HEADER.size, space, socket.MSG_CMSG_CLOEXEC)
        for level, kind, data in ancillary:
            if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
                received.frombytes(data[: len(data) - len(data) % received.itemsize])
        header += self._exactly(_HEADER.size - len(header)) if header else b""
        if not header:
            raise EOFError("the other end of the channel closed")
        length, fd_count = _HEADER.unpack(header)
        fds = list(received)
        if len(fds) != fd_count:
            for fd in fds:
                os.close(fd)
            raise OSError(f"{fd_count} file descriptors announced, {len(fds)} received (limit on open files?)")
        return pickle.loads(self._exactly(length)), fds

    def close(self) -> None:
        """Close this end."""
        self._sock.close()

    def _exactly(self, count: int) -> bytes:
        parts = []
        while count:
            part = self._sock.recv(count)
            if not part:
                raise EOFError("the other end of the channel closed in the middle of a message")
            parts.append(part)
            count -= len(part)
        return b"".join(parts)


def start_module(module: str) -> tuple[Channel, int]:
    """Start ``python -m MODULE --channel-fd N`` as a child; returns our end of its channel and its process id.

    Raises:
        OSError: The process cannot be started.
    """
    ours, theirs = Channel.pair()
    try:
        pid = os.posix_spawn(
            sys.executable,
            [sys.executable, "-m", module, "--channel-fd", str(_CHILD_FD)],
            os.environ,
            file_actions=[(os.POSIX_SPAWN_DUP2, theirs.fileno(), _CHILD_FD)],
        )
    finally:
        theirs.close()
    return ours, pid
