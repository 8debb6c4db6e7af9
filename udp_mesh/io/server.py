"""The daemon's side of the Unix socket: connections of local applications, each with bounded buffers."""

from __future__ import annotations

import contextlib
import socket
import stat
from collections import deque
from pathlib import Path

from udp_mesh import local_wire
from udp_mesh.local_wire import FrameReader, FrameType, LocalProtocolError, Publish

MAX_CONNECTIONS = 256
MAX_WAITING_BYTES = 8 * 1024 * 1024
ALL_TOPICS = "*"
_READ_BYTES = 256 * 1024
_BATCH = 16
_SOCKET_MODE = 0o600


class SocketInUse(Exception):
    """Another daemon serves this path, or it cannot be created."""


class Connection:
    """One application."""

    def __init__(self, sock: socket.socket) -> None:
        self.socket = sock
        self.topics: set[str] = set()
        self.parked: Publish | None = None  # waits for room in the queue; nothing is read meanwhile
        self.is_closed = False
        self._reader = FrameReader()
        self._frames: deque[tuple[bytes, bool]] = deque()  # bytes, whether a slow reader may lose them
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
                data = self.socket.recv(_READ_BYTES)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self.is_closed = True
                return
            try:
                self._pending.extend(self._reader.feed(data))
            except LocalProtocolError:
                self.is_closed = True
                return
            if len(data) < _READ_BYTES:
                return

    def next_frame(self) -> tuple[int, memoryview] | None:
        """Return the next frame, None while there is none or a publish waits for room."""
        return self._pending.popleft() if self._pending and self.parked is None else None

    @property
    def is_readable(self) -> bool:
        """Whether more should be read: an application that waits for room is not read, and so held back."""
        return self.parked is None and not self._pending

    def send(self, frame: bytes, *, may_lose: bool = False) -> None:
        """Queue a frame. Too slow a reader loses the oldest messages, and is told how many."""
        if self._lost and may_lose:
            self._append(local_wire.encode_lost(self._lost), may_lose=False)
            self._lost = 0
        self._append(frame, may_lose=may_lose)
        while self._waiting_bytes > MAX_WAITING_BYTES and len(self._frames) > 1 and self._lose_oldest():
            pass
        if self._waiting_bytes > 2 * MAX_WAITING_BYTES + local_wire.MAX_FRAME_BYTES:
            self.is_closed = True  # it asks and never reads

    def _append(self, frame: bytes, *, may_lose: bool) -> None:
        self._frames.append((frame, may_lose))
        self._waiting_bytes += len(frame)

    def _lose_oldest(self) -> bool:
        start = 1 if self._first_sent else 0  # a frame of which a part was read cannot be taken back
        for index in range(start, len(self._frames) - 1):
            frame, may_lose = self._frames[index]
            if may_lose:
                del self._frames[index]
                self._waiting_bytes -= len(frame)
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
            frame, _may_lose = self._frames[0]
            try:
                sent = self.socket.send(memoryview(frame)[self._first_sent :])
            except BlockingIOError:
                return
            except OSError:
                self.is_closed = True
                return
            self._first_sent += sent
            if self._first_sent == len(frame):
                self._frames.popleft()
                self._waiting_bytes -= len(frame)
                self._first_sent = 0


class LocalServer:
    """Listens on the Unix socket."""

    def __init__(self, path: str) -> None:
        """Listen.

        Raises:
            SocketInUse: Another daemon answers there, or the path cannot be bound.
        """
        self.path = path
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        self.connections: list[Connection] = []
        try:
            self._remove_stale()
            self.socket.bind(path)
            Path(path).chmod(_SOCKET_MODE)
            self.socket.listen(64)
        except OSError as error:
            self.socket.close()
            raise SocketInUse(f"{path}: cannot listen here: {error.strerror or error}") from error
        except SocketInUse:
            self.socket.close()
            raise

    def _remove_stale(self) -> None:
        """Remove the socket of a daemon that was killed; nobody answers there."""
        path = Path(self.path)
        if not path.exists() or not stat.S_ISSOCK(path.stat().st_mode):
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            try:
                probe.connect(self.path)
            except OSError:
                path.unlink()
                return
        raise SocketInUse(f"{self.path}: another daemon serves this socket; choose another with socket = ...")

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
        frame: bytes | None = None
        for connection in self.connections:
            if connection.wants(message.topic):
                frame = frame or local_wire.encode_message(message)
                connection.send(frame, may_lose=True)

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
