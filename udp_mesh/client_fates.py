"""Tracked messages as an application sees them: what has become of them so far. No sockets."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Generator

from udp_mesh import local_fates
from udp_mesh.local_fates import Fate, Outcome, Tracked, unknown

MAX_OPEN = 65_536


class TrackedMessage:
    """A message whose fate is told, for each destination apart."""

    def __init__(self, to: str) -> None:
        self.to = to
        self._fates: dict[str, Fate] = {}
        self._peers: tuple[str, ...] | None = None

    @property
    def peers(self) -> tuple[str, ...]:
        """The nodes to which it goes; empty until the daemon has told, within milliseconds."""
        return self._peers or ()

    @property
    def fates(self) -> dict[str, Fate]:
        """What is known by now, by the name of the node."""
        return dict(self._fates)

    @property
    def is_complete(self) -> bool:
        """Whether the fate at every destination is known."""
        return self._peers is not None and all(peer in self._fates for peer in self._peers)

    @property
    def is_acknowledged(self) -> bool:
        """Whether every destination has acknowledged it."""
        return self.is_complete and all(fate.outcome is Outcome.ACKNOWLEDGED for fate in self._fates.values())

    def goes_to(self, peers: tuple[str, ...]) -> None:
        """Note for whom the daemon has it."""
        if peers:
            self._peers = peers
        else:
            self.end(unknown(self.to, "settled_unseen"))

    def ended_at(self, fate: Fate) -> None:
        """Note what became of it at one destination; the first word counts."""
        self._fates.setdefault(fate.peer, fate)

    def end(self, fate: Fate) -> None:
        """Give every destination that is open the same fate; the only one, if none is known yet."""
        if self._peers is None:
            self._peers = (*self._fates, fate.peer)
        for peer in self._peers:
            ended = Fate(peer, fate.outcome, fate.reason, may_have_arrived=fate.may_have_arrived)
            self._fates.setdefault(peer, ended)


class Delivery(TrackedMessage):
    """What :meth:`udp_mesh.client.Client.publish_tracked` returns. Known whenever the client reads: while it waits,
    receives, publishes or asks."""

    def __init__(self, to: str, wait: Callable[[Callable[[], bool], float | None], bool]) -> None:
        super().__init__(to)
        self._wait = wait

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until the fate at every destination is known; False if it is not within ``timeout_s``.

        Raises:
            ClientError: The client was closed.
        """
        return self._wait(lambda: self.is_complete, timeout_s)


class AsyncDelivery(TrackedMessage):
    """The same for asyncio: ``fates = await delivery``, or :meth:`wait` with a time-out."""

    def __init__(self, to: str, wait: Callable[[Callable[[], bool], float | None], Awaitable[bool]]) -> None:
        super().__init__(to)
        self._wait = wait

    async def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until the fate at every destination is known; False if it is not within ``timeout_s``."""
        return await self._wait(lambda: self.is_complete, timeout_s)

    async def _all(self) -> dict[str, Fate]:
        await self.wait()
        return self.fates

    def __await__(self) -> Generator[None, None, dict[str, Fate]]:
        return self._all().__await__()


class OpenMessages:
    """Tracked messages by request. ``MAX_OPEN`` are followed; beyond it the oldest ends as unknown."""

    def __init__(self) -> None:
        self._open: dict[int, TrackedMessage] = {}
        self._stored: dict[int, int] = {}  # request -> sequence of the first destination, once the daemon has it

    def __len__(self) -> int:
        """Messages of which the fate is open at some destination."""
        return len(self._open)

    def add(self, request: int, message: TrackedMessage) -> None:
        """Follow a message."""
        self._open[request] = message
        if len(self._open) > MAX_OPEN:
            oldest = next(iter(self._open))
            self._end(oldest, unknown(self._open[oldest].to, "not_followed"))

    def forget(self, request: int) -> None:
        """Follow a message no longer that never left this client."""
        self._open.pop(request, None)
        self._stored.pop(request, None)

    def on_tracked(self, tracked: Tracked, *, is_stored: bool) -> None:
        """Take the daemon's word for whom it has a message."""
        message = self._open.get(tracked.request)
        if message is None or message.peers:
            return  # ended, or told again over a new connection
        message.goes_to(tracked.peers)
        if is_stored:
            self._stored[tracked.request] = tracked.message_id
        self._close_if_complete(tracked.request, message)

    def on_fate(self, request: int, fate: Fate) -> None:
        """Take the daemon's word for what became of a message at one destination."""
        message = self._open.get(request)
        if message is not None:
            message.ended_at(fate)
            self._close_if_complete(request, message)

    def on_refused(self, request: int, reason: str) -> None:
        """Take the daemon's word that it has not taken a message."""
        if request in self._open:
            self._end(request, Fate(self._open[request].to, Outcome.FAILED, reason))

    def on_disconnected(self, undecided: dict[int, bytes]) -> None:
        """End all but the stored ones: a daemon that comes back knows nothing of them.

        ``undecided``: stored publishes by request that the daemon may not have yet.
        """
        for request in [number for number in self._open if number not in undecided and number not in self._stored]:
            self._end(request, unknown(self._open[request].to, "daemon_unreachable"))

    def follow_frames(self) -> list[bytes]:
        """Return what asks a new connection for the fates of stored messages."""
        frames = []
        for request, sequence in self._stored.items():
            message = self._open[request]
            known = message.fates
            for number, peer in enumerate(message.peers, start=sequence):
                if peer not in known:
                    frames.append(local_fates.encode_follow(request, number, peer))
        return frames

    def _end(self, request: int, fate: Fate) -> None:
        self._open[request].end(fate)
        self.forget(request)

    def _close_if_complete(self, request: int, message: TrackedMessage) -> None:
        if message.is_complete:
            self.forget(request)
