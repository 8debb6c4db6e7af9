"""The daemon's side of the Unix socket: connections of local applications, each with bounded buffers."""

from __future__ import annotations

import contextlib
import itertools
import socket
from collections import deque
from pathlib import Path

from udp_mesh import local_wire
from udp_mesh.frame_reader import FrameReader
from udp_mesh.io.local_socket import listen
from udp_mesh.local_wire import FrameType, LocalProtocolError, Publish

MAX_CONNECTIONS = 256
MAX_WAITING_BYTES = 32 * 1024 * 1024  # a fast path fills it in a fifth of a second
ALL_TOPICS = "*"
_BATCH = 16
_BACKLOG = 64
_NUMBERS = itertools.count(1)


class _Output:
    """A frame on its way to an application, in pieces that follow each other. ``may_lose``: if it reads too slowly."""

    __slots__ = ("_pieces", "may_lose", "size_bytes")

    def __init__(self, pieces: tuple[bytes | memoryview, ...], *, may_lose: bool) -> None:
        self._pieces = pieces
        self.may_lose = may_lose
        self.size_bytes = sum(map(len, pieces))

    def rest(self, sent_bytes: int) -> list[bytes | memoryview]:
        """Return what follows the bytes that were sent."""
        rest: list[bytes | memoryview] = []
        for piece in self._pieces:
            if sent_bytes < len(piece):
                rest.append(memoryview(piece)[sent_bytes:] if sent_bytes else piece)
            sent_bytes = max(0, sent_bytes - len(piece))
        return rest


class Connection:
    """One application."""

    def __init__(self, sock: socket.socket) -> None:
        self.socket = sock
        self.number = next(_NUMBERS)  # tells it from every other of this daemon
        self.client = 0  # the application's own random number; it keeps it across connections
        self.topics: set[str] = set()
        self.parked: Publish | None = None  # waits for room in the queue; nothing is read meanwhile
        self.is_closed = False
        self.watched = 0  # for which events the loop waits
        self._reader = FrameReader()
        self._frames: deque[_Output] = deque()
        self._waiting_bytes = 0
        self._first_sent = 0
        self._lost = 0
        self._pending: deque[tuple[int, memoryview]] = deque()

    def fileno(self) -> int:
        """The socket's descriptor."""
        return self.socket.fileno()

    def wants(self, topic: str) -> bool:
        """Whether the application subscribed to a topic."""
        return topic in self.topics or ALL_TOPICS in self.topics

    def read(self) -> None:
        """Take what the application wrote; it waits for :meth:`next_frame`."""
        for _ in range(_BATCH):
            try:
                buffer = self._reader.buffer()
                size = self.socket.recv_into(buffer)
                if size:
                    self._pending.extend(self._reader.filled(size))
                    if size < len(buffer):
                        return
                    continue
            except BlockingIOError:
                return
            except (OSError, LocalProtocolError):
                pass
            self.is_closed = True
            return

    def next_frame(self) -> tuple[int, memoryview] | None:
        """Return the next frame, None while there is none or a publish waits for room."""
        return self._pending.popleft() if self._pending and self.parked is None else None

    @property
    def is_readable(self) -> bool:
        """Whether more should be read: an application that waits for room is not read, and so held back."""
        return self.parked is None and not self._pending

    def send(self, frame: bytes, payload: bytes | memoryview = b"", *, may_lose: bool = False) -> None:
        """Queue a frame, of which ``payload`` is the end. Too slow a reader loses the oldest messages, and is told."""
        if may_lose:
            self._tell_lost()
        self._append(_Output((frame, payload) if payload else (frame,), may_lose=may_lose))
        while self._waiting_bytes > MAX_WAITING_BYTES and len(self._frames) > 1 and self._lose_oldest():
            pass
        if self._waiting_bytes > 2 * MAX_WAITING_BYTES + local_wire.MAX_FRAME_BYTES:
            self.is_closed = True  # it asks and never reads

    def _tell_lost(self) -> None:
        if self._lost:
            self._append(_Output((local_wire.encode_lost(self._lost),), may_lose=False))
            self._lost = 0

    def _append(self, output: _Output) -> None:
        self._frames.append(output)
        self._waiting_bytes += output.size_bytes

    def _lose_oldest(self) -> bool:
        start = 1 if self._first_sent else 0  # a frame of which a part was read cannot be taken back
        for index in range(start, len(self._frames) - 1):
            output = self._frames[index]
            if output.may_lose:
                del self._frames[index]
                self._waiting_bytes -= output.size_bytes
                self._lost += 1
                return True
        return False

    @property
    def has_output(self) -> bool:
        """Whether something waits for the application to read."""
        return bool(self._frames)

    def flush(self) -> None:
        """Write what the application takes now."""
        while self._frames and not self.is_closed:
            output = self._frames[0]
            try:
                self._first_sent += self.socket.sendmsg(output.rest(self._first_sent))
            except BlockingIOError:
                return
            except OSError:
                self.is_closed = True
                return
            if self._first_sent == output.size_bytes:
                self._frames.popleft()
                self._waiting_bytes -= output.size_bytes
                self._first_sent = 0
                if not self._frames:
                    self._tell_lost()  # perhaps no message follows with which it could be told


class LocalServer:
    """Listens on the Unix socket."""

    def __init__(self, path: str) -> None:
        """Listen.

        Raises:
            SocketInUse: Another daemon answers there, or the path cannot be bound.
        """
        self.path = path
        self.socket = listen(path, backlog=_BACKLOG)
        self.connections: list[Connection] = []

    def fileno(self) -> int:
        """The listening socket's descriptor."""
        return self.socket.fileno()

    def accept(self) -> Connection | None:
        """Return a new connection, None if there is none or there are too many."""
        try:
            sock, _address = self.socket.accept()
        except OSError:
            return None
        if len(self.connections) >= MAX_CONNECTIONS:
            sock.close()
            return None
        sock.setblocking(False)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1024 * 1024)
        connection = Connection(sock)
        self.connections.append(connection)
        return connection

    def remove(self, connection: Connection) -> None:
        """Forget a connection."""
        self.connections.remove(connection)
        connection.socket.close()

    def deliver(self, message: local_wire.Message) -> None:
        """Give a message to every subscriber of its topic."""
        head = b""
        for connection in self.connections:
            if connection.wants(message.topic):
                head = head or local_wire.encode_message_head(message)
                connection.send(head, message.payload, may_lose=True)

    def tell_all(self, kind: FrameType, value: object) -> None:
        """Send a JSON frame to every application."""
        frame = local_wire.json_frame(kind, value)
        for connection in self.connections:
            connection.send(frame)

    def close(self) -> None:
        """Close everything and remove the socket's path."""
        for connection in list(self.connections):
            connection.flush()
            self.remove(connection)
        self.socket.close()
        Path(self.path).unlink(missing_ok=True)
