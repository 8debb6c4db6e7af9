"""The lab's control socket: one JSON request per message, answers on the same connection.

SOCK_SEQPACKET keeps message borders and lets `exec` pass its standard streams. Only the lab's owner may speak: the
folder is private, and the kernel's word on the peer's user id is checked as well.
Requests: see :mod:`netlab.lab.requests`.
"""

from __future__ import annotations

import array
import asyncio
import contextlib
import json
import os
import socket
import struct
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

from netlab.errors import LabError, NetlabError

_MAX_MESSAGE = 1 << 20
_UCRED = struct.Struct("3i")

Request = dict[str, Any]
Reply = dict[str, Any]


class Connection:
    """One client's connection, on the supervisor's side."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._closed = False
        self.on_close: Callable[[], None] = lambda: None

    def send(self, reply: Reply) -> None:
        """Answer; a client that is gone or does not read is dropped."""
        try:
            self._sock.send(json.dumps(reply).encode())
        except OSError:
            self.close()

    def close(self) -> None:
        """Hang up."""
        if not self._closed:
            self._closed = True
            asyncio.get_running_loop().remove_reader(self._sock.fileno())
            self._sock.close()
            self.on_close()


Handler = Callable[[Request, list[int], Connection], Awaitable[Reply | None]]


class ControlServer:
    """Accepts the owner's connections and runs ``handler`` for each request; None means it answers by itself."""

    def __init__(self, path: Path, handler: Handler) -> None:
        self._handler = handler
        self._tasks: set[asyncio.Task[None]] = set()
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        old_mask = os.umask(0o177)
        try:
            self._sock.bind(str(path))
        finally:
            os.umask(old_mask)
        self._sock.listen(16)
        self._sock.setblocking(False)
        asyncio.get_running_loop().add_reader(self._sock.fileno(), self._accept)

    def close(self) -> None:
        """Stop listening."""
        asyncio.get_running_loop().remove_reader(self._sock.fileno())
        self._sock.close()

    def _accept(self) -> None:
        try:
            sock, _ = self._sock.accept()
        except BlockingIOError:
            return
        credentials = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
        if _UCRED.unpack(credentials)[1] != os.getuid():
            sock.close()
            return
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _MAX_MESSAGE)
        connection = Connection(sock)
        asyncio.get_running_loop().add_reader(sock.fileno(), self._receive, sock, connection)

    def _receive(self, sock: socket.socket, connection: Connection) -> None:
        try:
            data, fds = _receive_with_fds(sock)
        except BlockingIOError:
            return
        except OSError:
            data, fds = b"", []
        if not data:
            connection.close()
            return
        task = asyncio.get_running_loop().create_task(self._answer(data, fds, connection))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _answer(self, data: bytes, fds: list[int], connection: Connection) -> None:
        try:
            request = json.loads(data)
            if not isinstance(request, dict):
                raise LabError("a request is a JSON object")
            reply = await self._handler(request, fds, connection)
        except NetlabError as error:
            reply = {"error": str(error)}
        except (ValueError, KeyError, TypeError) as error:
            reply = {"error": f"bad request: {error!r}"}
        except OSError as error:  # a part of the lab is gone, or the machine is out of something
            reply = {"error": f"the lab could not do that: {error}"}
        finally:
            for fd in fds:
                with contextlib.suppress(OSError):
                    os.close(fd)
        if reply is not None:
            connection.send(reply)


class ControlClient:
    """A command's blocking connection to a lab."""

    def __init__(self, path: Path) -> None:
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._sock.connect(str(path))
        except OSError as error:
            self._sock.close()
            raise LabError(f"the lab at {path} does not answer: {error}") from error

    def request(self, request: Request, fds: Sequence[int] = (), *, timeout_s: float | None = 30.0) -> Reply:
        """Send a request and return its first answer.

        Raises:
            LabError: The lab refused, is gone or did not answer in time.
        """
        ancillary = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", fds))] if fds else []
        try:
            self._sock.sendmsg([json.dumps(request).encode()], ancillary)
        except OSError as error:
            raise LabError(f"the lab is gone: {error}") from error
        return self.next_reply(timeout_s=timeout_s)

    def next_reply(self, *, timeout_s: float | None = None) -> Reply:
        """Wait for a further answer on this connection."""
        self._sock.settimeout(timeout_s)
        try:
            data = self._sock.recv(_MAX_MESSAGE)
        except TimeoutError as error:
            raise LabError(f"the lab did not answer within {timeout_s} s") from error
        except OSError as error:
            raise LabError(f"the lab is gone: {error}") from error
        if not data:
            raise LabError("the lab has ended")
        reply: Reply = json.loads(data)
        if "error" in reply:
            raise LabError(reply["error"])
        return reply

    def fileno(self) -> int:
        """The socket, for a selector."""
        return self._sock.fileno()

    def close(self) -> None:
        """Hang up; a command that the lab runs for this connection ends."""
        self._sock.close()


def _receive_with_fds(sock: socket.socket) -> tuple[bytes, list[int]]:
    fds: array.array[int] = array.array("i")
    data, ancillary, _flags, _address = sock.recvmsg(
        _MAX_MESSAGE, socket.CMSG_LEN(8 * fds.itemsize), socket.MSG_CMSG_CLOEXEC
    )
    for level, kind, payload in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
            fds.frombytes(payload[: len(payload) - len(payload) % fds.itemsize])
    return data, list(fds)
