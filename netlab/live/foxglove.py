"""What a running lab records, shown to Foxglove as it is recorded: the same channels as in the capture.

A WebSocket server on this machine's own address, for readers only: no client can publish, call or set anything.
Foxglove keeps nothing for those who come late, so what stands for a whole topic is sent again every few seconds.
"""

from __future__ import annotations

import importlib.util
import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING, Protocol

from netlab.errors import MachineError
from netlab.live.feed import Feed, FeedMessage

if TYPE_CHECKING:
    import foxglove

DEFAULT_PORT = 8765
_HOST = "127.0.0.1"
_AGAIN_S = 3.0
_WAIT_S = 0.2
_STANDING = ("/map", "/poses", "/nodes/scene", "/links/scene", "/mesh/scene")


class Sink(Protocol):
    """Where one channel's messages go."""

    def log(self, msg: bytes, *, log_time: int | None = None) -> None:
        """Send a message."""


def require_foxglove() -> None:
    """Say in time that nothing can be shown.

    Raises:
        MachineError: foxglove-sdk is not installed.
    """
    if importlib.util.find_spec("foxglove") is None:
        raise MachineError(
            "the live view for Foxglove needs foxglove-sdk; install it: pip install 'udp-mesh-lab[foxglove]'"
        )


class FoxgloveServer:
    """Shows a feed until it ends. Use as a context manager; it takes the feed over.

    Attributes:
        port: Where it listens.
        described: Set when ``metadata`` is known.
        ended: Set when the lab's recorder has ended.
    """

    def __init__(self, feed: Feed, *, name: str, port: int = DEFAULT_PORT, again_s: float = _AGAIN_S) -> None:
        """Listen at ``port`` (0: any that is free) of 127.0.0.1.

        Raises:
            MachineError: foxglove-sdk is not installed, or the port is taken.
        """
        require_foxglove()
        import foxglove

        self._feed = feed
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name=name, host=_HOST, port=port, context=self._context, capabilities=[], services=[]
            )
        except (OSError, RuntimeError) as error:
            feed.close()
            raise MachineError(f"{_HOST}:{port} cannot be listened at: {error}; choose another port") from None
        self.port: int = self._server.port
        self.described = threading.Event()
        self.ended = threading.Event()
        self._again_s = again_s
        self._channels: dict[int, Sink] = {}
        self._standing: dict[int, FeedMessage] = {}
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)

    @property
    def url(self) -> str:
        """What to open in Foxglove ("Open connection")."""
        return f"ws://{_HOST}:{self.port}"

    @property
    def metadata(self) -> dict[str, str]:
        """The run's metadata, as known by now."""
        return self._feed.metadata

    def __enter__(self) -> FoxgloveServer:
        """Begin to show."""
        self._thread.start()
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """Show no more."""
        self._stopping = True
        self._thread.join()
        self._feed.close()
        self._server.stop()

    def _run(self) -> None:
        again_at = time.monotonic() + self._again_s
        while not self._stopping and not self._feed.ended:
            for message in self._feed.receive(timeout_s=_WAIT_S):
                self._show(message)
            if self._feed.metadata:
                self.described.set()
            if (now := time.monotonic()) >= again_at:
                again_at = now + self._again_s
                for message in self._standing.values():
                    self._channel(message).log(message.data, log_time=message.log_ns)
        self.ended.set()

    def _show(self, message: FeedMessage) -> None:
        if message.topic in _STANDING:
            self._standing[message.channel.id] = message
        self._channel(message).log(message.data, log_time=message.log_ns)

    def _channel(self, message: FeedMessage) -> Sink:
        number = message.channel.id
        if number not in self._channels:
            self._channels[number] = self._new_channel(message)
        return self._channels[number]

    def _new_channel(self, message: FeedMessage) -> foxglove.Channel:
        import foxglove

        schema = foxglove.Schema(name=message.schema.name, encoding=message.schema.encoding, data=message.schema.data)
        return foxglove.Channel(
            message.topic,
            schema=schema,
            message_encoding=message.channel.message_encoding,
            context=self._context,
            metadata=dict(message.channel.metadata),
        )
