"""For applications: publish, subscribe, ask. No dependencies; the daemon does the networking.

    with Client() as mesh:
        mesh.subscribe("telemetry")
        mesh.publish("command", b"go", to="robot1", priority=1)
        for message in mesh:
            print(message.source, message.payload)

:class:`Client` is for ordinary programs, :class:`AsyncClient` for asyncio. Both reconnect to a restarted daemon by
themselves and subscribe again.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from types import TracebackType

from udp_mesh import local_wire
from udp_mesh.client_async import AsyncClient
from udp_mesh.client_state import (
    ClientError,
    ClientState,
    PeerInfo,
    Refused,
    RequestFailed,
    WouldBlock,
    overrides_of,
    peers_of,
    result_of,
    table_of,
)
from udp_mesh.config import default_socket
from udp_mesh.local_wire import FrameType, LocalProtocolError, Message

__all__ = ["AsyncClient", "Client", "ClientError", "Message", "PeerInfo", "Refused", "RequestFailed", "WouldBlock"]

_RECONNECT_INTERVAL_S = 0.05
_ANSWER_WITHIN_S = 5.0
_FINISH_WITHIN_S = 0.05
_READ_BYTES = 256 * 1024


class Client:
    """A connection to this node's daemon. Not for use by several threads at once."""

    def __init__(self, socket_path: str | None = None, *, connect_timeout_s: float = 5.0) -> None:
        """Connect.

        Raises:
            ClientError: No daemon answered within ``connect_timeout_s``.
        """
        self.path = socket_path or default_socket()
        self._state = ClientState()
        self._socket: socket.socket | None = None
        self._rest = b""  # of a frame of which the daemon has taken a part
        self._retry_at_s = 0.0
        if not self._wait(lambda: self._state.is_greeted, connect_timeout_s):
            raise ClientError(f"no udp-mesh daemon answers at {self.path}; is it running?")

    # -- messages

    def publish(
        self,
        topic: str,
        payload: bytes,
        *,
        to: str,
        priority: int | None = None,
        reliability: str | None = None,
        keep: str | None = None,
        lifetime_s: float | None = None,
        offline: str | None = None,
    ) -> None:
        """Hand a message to the daemon, for the node named ``to`` or ``all``. Does not wait.

        What is None comes from the topic's settings. Refusals that only the daemon can judge (a full queue, a peer lost
        this instant) arrive later and are counted in :attr:`refusals`.

        Raises:
            Refused: It was not taken; ``reason`` says why.
            WouldBlock: The daemon does not keep up.
            ValueError: An argument is none of its choices.
        """
        overrides = overrides_of(priority, reliability, keep, offline, lifetime_s)
        self._pump(0.0)
        if self._socket is None:
            raise Refused("daemon_unreachable")
        _request, frame = self._state.encode_publish(topic, payload, to, overrides, waits=False)
        self._send(frame)

    def publish_wait(
        self,
        topic: str,
        payload: bytes,
        *,
        to: str,
        timeout_s: float | None = None,
        priority: int | None = None,
        reliability: str | None = None,
        keep: str | None = None,
        lifetime_s: float | None = None,
        offline: str | None = None,
    ) -> int:
        """Hand a message to the daemon and wait until it has taken it: with back-pressure. Return its message id.

        Raises:
            Refused: It was not taken; ``reason`` says why.
            WouldBlock: The queue had no room within ``timeout_s``; the message may still be taken.
            ValueError: An argument is none of its choices.
        """
        overrides = overrides_of(priority, reliability, keep, offline, lifetime_s)
        self._pump(0.0)
        request, frame = self._state.encode_publish(topic, payload, to, overrides, waits=True)
        if not self._wait(lambda: self._try_send(frame), timeout_s):
            raise WouldBlock("the daemon does not keep up")
        sock = self._socket
        verdicts: list[local_wire.Verdict] = []

        def is_decided() -> bool:
            verdict = self._state.take_verdict(request)
            if verdict is not None:
                verdicts.append(verdict)
            return verdict is not None or self._socket is not sock

        if not self._wait(is_decided, timeout_s):
            raise WouldBlock("the queue had no room in time")
        if not verdicts:
            raise Refused("daemon_unreachable")
        if verdicts[0].reason:
            raise Refused(verdicts[0].reason)
        return verdicts[0].message_id

    def subscribe(self, topic: str) -> None:
        """Receive messages of this topic from now on; ``*`` is every topic."""
        if topic not in self._state.topics:
            self._state.topics.append(topic)
            self._command(local_wire.frame(FrameType.SUBSCRIBE, topic.encode()))

    def unsubscribe(self, topic: str) -> None:
        """Receive no more messages of this topic."""
        if topic in self._state.topics:
            self._state.topics.remove(topic)
            self._command(local_wire.frame(FrameType.UNSUBSCRIBE, topic.encode()))

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Return the next message, waiting for it if need be; None when ``timeout_s`` is over. 0 does not wait."""
        self._wait(lambda: bool(self._state.inbox), timeout_s)
        return self._state.inbox.popleft() if self._state.inbox else None

    def __iter__(self) -> Iterator[Message]:
        """Yield messages for ever."""
        while True:
            message = self.receive()
            if message is not None:
                yield message

    @property
    def missed(self) -> int:
        """Messages lost because this application read too slowly."""
        return self._state.missed

    @property
    def refusals(self) -> Counter[str]:
        """Refused messages by reason, those included that the daemon refused after ``publish`` returned."""
        return self._state.refusals

    # -- questions

    def peers(self) -> list[PeerInfo]:
        """Return every node ever heard by the daemon."""
        return peers_of(self._ask("peers"))

    def wait_for_peer(self, name: str, timeout_s: float) -> bool:
        """Wait until a peer is online; False if it was not within ``timeout_s``."""
        return self._wait(lambda: self._state.is_online(name), timeout_s)

    def stats(self) -> dict[str, object]:
        """Return the daemon's counters, queue depths and peers."""
        return table_of(self._ask("stats"))

    def config_get(self) -> dict[str, object]:
        """Return the daemon's settings."""
        return table_of(self._ask("config_get"))

    def config_set(self, key: str, value: str) -> dict[str, object]:
        """Change a setting while the daemon runs; return all settings.

        Raises:
            RequestFailed: The key cannot be changed, or the value is wrong.
        """
        return table_of(self._ask("config_set", key=key, value=value))

    # -- connection

    def fileno(self) -> int:
        """Descriptor to wait on for reading; then call ``receive(timeout_s=0)`` until it returns None.

        It changes with every reconnection.

        Raises:
            ClientError: There is no connection now.
        """
        if self._socket is None:
            raise ClientError("not connected to the daemon")
        return self._socket.fileno()

    def close(self) -> None:
        """Disconnect; messages not yet taken by the daemon get a moment to leave."""
        if self._socket is not None:
            self._finish(_FINISH_WITHIN_S)
        self._disconnect()
        self._retry_at_s = float("inf")

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, method: str, **arguments: str) -> object:
        request, frame = self._state.encode_request(method, **arguments)
        answers: list[dict[str, object]] = []

        def is_answered() -> bool:
            answer = self._state.take_answer(request)
            if answer is not None:
                answers.append(answer)
            return bool(answers)

        if not self._wait(lambda: self._try_send(frame), _ANSWER_WITHIN_S) or not self._wait(
            is_answered, _ANSWER_WITHIN_S
        ):
            raise RequestFailed(f"the daemon did not answer within {_ANSWER_WITHIN_S:g} s")
        return result_of(answers[0])

    def _command(self, frame: bytes) -> None:
        """Send a frame that a reconnection would repeat anyway."""
        if self._socket is not None:
            self._wait(lambda: self._socket is None or self._try_send(frame), _ANSWER_WITHIN_S)

    def _try_send(self, frame: bytes) -> bool:
        if self._socket is None:
            return False
        try:
            self._send(frame)
        except WouldBlock:
            return False
        return True

    def _send(self, frame: bytes) -> None:
        """Send a frame as a whole or not at all; the rest of one begun leaves before anything else."""
        if self._rest and not self._finish(0.0):
            raise WouldBlock("the daemon does not keep up")
        assert self._socket is not None
        try:
            sent = self._socket.send(frame)
        except BlockingIOError:
            raise WouldBlock("the daemon does not keep up") from None
        except OSError:
            self._disconnect()
            raise Refused("daemon_unreachable") from None
        self._rest = frame[sent:]
        if self._rest:
            self._finish(_FINISH_WITHIN_S)  # larger than the socket's buffer: the daemon is reading it now

    def _finish(self, within_s: float) -> bool:
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

    def _wait(self, is_done: Callable[[], bool], timeout_s: float | None) -> bool:
        until_s = None if timeout_s is None else time.monotonic() + timeout_s
        self._pump(0.0)
        while not is_done():
            left_s = 1.0 if until_s is None else until_s - time.monotonic()
            if left_s <= 0:
                return False
            self._pump(min(left_s, 1.0))
        return True

    def _pump(self, wait_s: float) -> None:
        """Read what is there, waiting at most ``wait_s`` for it; reconnect if the connection was lost."""
        if self._socket is None:
            self._connect(wait_s)
            return
        sock = self._socket
        writers = [sock] if self._rest else []
        readable, writable, _ = select.select([sock], writers, [], wait_s)
        if writable:
            self._finish(0.0)
        if readable and self._socket is sock:
            self._read(sock)

    def _read(self, sock: socket.socket) -> None:
        try:
            while data := sock.recv(_READ_BYTES):
                self._state.feed(data)
                if len(data) < _READ_BYTES:
                    return
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
        self._rest = b""
        greeting = self._state.connected()
        if greeting:
            self._send(greeting)

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._rest = b""
