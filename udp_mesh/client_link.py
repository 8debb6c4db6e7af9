"""The blocking client's connection: sends whole frames, reads what comes, reconnects to a restarted daemon."""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Callable

from udp_mesh.client_state import ClientState
from udp_mesh.client_types import ClientError, Refused, WouldBlock
from udp_mesh.local_wire import LocalProtocolError

FINISH_WITHIN_S = 0.05
_RECONNECT_INTERVAL_S = 0.05


class Link:
    """A Unix stream socket to the daemon at ``path``; what it reads goes to ``state``."""

    def __init__(self, path: str, state: ClientState) -> None:
        self.path = path
        self.connections = 0  # made so far
        self._state = state
        self._socket: socket.socket | None = None
        self._rest = memoryview(b"")  # of a frame of which the daemon has taken a part
        self._retry_at_s = 0.0
        self._is_closed = False

    @property
    def is_connected(self) -> bool:
        """Whether there is a connection, as far as is known."""
        return self._socket is not None

    def fileno(self) -> int:
        """The socket's descriptor.

        Raises:
            ClientError: There is no connection now.
        """
        if self._socket is None:
            raise ClientError("not connected to the daemon")
        return self._socket.fileno()

    def close(self) -> None:
        """Disconnect for good; what is half sent gets a moment to leave."""
        if self._socket is not None:
            self.finish(FINISH_WITHIN_S)
        self._disconnect()
        self._is_closed = True

    def try_send(self, frame: bytes) -> bool:
        """Send a frame unless that would block or there is no connection; whether it was sent."""
        if self._socket is None:
            return False
        try:
            self.send(frame)
        except WouldBlock:
            return False
        return True

    def send(self, frame: bytes) -> None:
        """Send a frame as a whole or not at all; the rest of one begun leaves before anything else.

        Raises:
            WouldBlock: The daemon does not keep up.
            Refused: There is no daemon.
        """
        if self._rest and not self.finish(0.0):
            raise WouldBlock("the daemon does not keep up")
        if self._socket is None:
            raise Refused("daemon_unreachable")
        try:
            sent = self._socket.send(frame)
        except BlockingIOError:
            raise WouldBlock("the daemon does not keep up") from None
        except OSError:
            self._disconnect()
            raise Refused("daemon_unreachable") from None
        self._rest = memoryview(frame)[sent:]
        if self._rest:
            self.finish(FINISH_WITHIN_S)  # larger than the socket's buffer: the daemon is reading it now

    def finish(self, within_s: float) -> bool:
        """Send the rest of a frame; True if nothing is left."""
        until_s = time.monotonic() + within_s
        while self._rest and self._socket is not None:
            try:
                self._rest = self._rest[self._socket.send(self._rest) :]
            except BlockingIOError:
                left_s = until_s - time.monotonic()
                if left_s <= 0 or not select.select([], [self._socket], [], left_s)[1]:
                    return False
            except OSError:
                self._disconnect()
        return not self._rest

    def wait(self, is_done: Callable[[], bool], timeout_s: float | None) -> bool:
        """Read until something holds; False if it does not within ``timeout_s`` (None: for ever)."""
        until_s = None if timeout_s is None else time.monotonic() + timeout_s
        self.pump(0.0)
        while not is_done():
            left_s = 1.0 if until_s is None else until_s - time.monotonic()
            if left_s <= 0:
                return False
            self.pump(min(left_s, 1.0))
        return True

    def pump(self, wait_s: float) -> None:
        """Read what is there, waiting at most ``wait_s`` for it; reconnect if the connection was lost.

        Raises:
            ClientError: The client was closed.
        """
        if self._is_closed:
            raise ClientError("this client was closed")
        if self._socket is None:
            self._connect(wait_s)
            return
        sock = self._socket
        writers = [sock] if self._rest else []
        readable, writable, _ = select.select([sock], writers, [], wait_s)
        if writable:
            self.finish(0.0)
        if readable and self._socket is sock:
            self._read(sock)

    def _read(self, sock: socket.socket) -> None:
        try:
            buffer = self._state.buffer()
            while size := sock.recv_into(buffer):
                self._state.filled(size)
                if size < len(buffer):
                    return
                buffer = self._state.buffer()
        except BlockingIOError:
            return
        except (OSError, LocalProtocolError):
            pass
        self._disconnect()

    def _connect(self, wait_s: float) -> None:
        now = time.monotonic()
        if now < self._retry_at_s:
            time.sleep(max(0.0, min(wait_s, self._retry_at_s - now)))
            return
        self._retry_at_s = now + _RECONNECT_INTERVAL_S
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * 1024 * 1024)
        try:
            sock.connect(self.path)
        except OSError:
            sock.close()
            return
        sock.setblocking(False)
        self._socket = sock
        self.connections += 1
        self._rest = memoryview(b"")
        greeting = self._state.connected()
        if greeting:
            with contextlib.suppress(ClientError):  # gone again: the next attempt greets anew
                self.send(greeting)

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._state.disconnected()
        self._socket = None
        self._rest = memoryview(b"")
