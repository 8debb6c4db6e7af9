"""The asyncio client's connection. It imports asyncio, which other clients do not pay for."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from typing import cast

from udp_mesh.client_state import ClientState
from udp_mesh.local_wire import LocalProtocolError

_SEND_BUFFER_BYTES = 4 * 1024 * 1024


class Stream(asyncio.BufferedProtocol):
    """One Unix stream to the daemon; what it reads goes to ``state``, then ``notify`` is called."""

    def __init__(self, state: ClientState, notify: Callable[[], None]) -> None:
        self._state = state
        self._notify = notify
        self._transport: asyncio.WriteTransport | None = None
        self._closed = asyncio.Event()

    @classmethod
    async def connect(cls, path: str, state: ClientState, notify: Callable[[], None]) -> Stream:
        """Return a connection.

        Raises:
            OSError: No daemon answers there.
        """
        _transport, stream = await asyncio.get_running_loop().create_unix_connection(lambda: cls(state, notify), path)
        return stream

    # -- what asyncio calls

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport, with room for a whole message in the socket."""
        self._transport = cast(asyncio.WriteTransport, transport)
        with contextlib.suppress(OSError):
            self._transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)

    def get_buffer(self, sizehint: int) -> memoryview:
        """Say where the next bytes belong."""
        return self._state.buffer()

    def buffer_updated(self, nbytes: int) -> None:
        """Take bytes; a damaged frame ends the connection."""
        try:
            has_frames = self._state.filled(nbytes)
        except LocalProtocolError:
            self.close()
            return
        if has_frames:
            self._notify()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wake who waits for the end."""
        self._closed.set()

    # -- what the client calls

    @property
    def is_open(self) -> bool:
        """Whether frames can be written."""
        return self._transport is not None and not self._transport.is_closing()

    @property
    def unsent_bytes(self) -> int:
        """What waits here because the daemon does not read."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    def write(self, frame: bytes) -> None:
        """Send a frame; never waits."""
        if self._transport is not None:
            self._transport.write(memoryview(frame))

    def close(self) -> None:
        """Disconnect once everything was sent."""
        if self._transport is not None:
            self._transport.close()

    async def wait_closed(self) -> None:
        """Wait until the connection has ended."""
        await self._closed.wait()
