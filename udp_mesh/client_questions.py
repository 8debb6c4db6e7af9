"""What both clients can ask their daemon about itself and about its peers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

from udp_mesh import local_features
from udp_mesh.client_state import ClientState
from udp_mesh.client_types import PeerInfo, Status, peers_of, table_of


class _Watching(ABC):
    """The state of links and queues, as the daemon sends it by itself."""

    _state: ClientState

    def watch_status(self, interval_s: float = 0.2) -> None:
        """Have the daemon send the state of links and queues now and at every interval (20 ms or more); 0 ends it.

        It appears in :attr:`status` whenever this client reads: while it receives, waits or asks.
        """
        self._state.status_interval_s = interval_s
        self._command(local_features.encode_watch(interval_s))

    @property
    def status(self) -> Status | None:
        """The newest state of links and queues, None before the first; see :meth:`watch_status`."""
        return self._state.status

    @abstractmethod
    def _command(self, frame: bytes) -> None:
        """Send a frame that a reconnection would repeat anyway."""


class Questions(_Watching):
    """Answered while the caller waits."""

    def peers(self) -> list[PeerInfo]:
        """Return every node ever heard by the daemon."""
        return peers_of(self._ask("peers"))

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

    def wait_for_peer(self, name: str, timeout_s: float) -> bool:
        """Wait until a peer is online; False if it was not within ``timeout_s``."""
        return self._wait(lambda: self._state.is_online(name), timeout_s)

    def wait_for_status(self, timeout_s: float | None = None) -> Status | None:
        """Wait for the next state; None if there was none within ``timeout_s``."""
        before = self._state.status
        self._wait(lambda: self._state.status is not before, timeout_s)
        return None if self._state.status is before else self._state.status

    @abstractmethod
    def _ask(self, method: str, **arguments: str) -> object: ...

    @abstractmethod
    def _wait(self, is_done: Callable[[], bool], timeout_s: float | None) -> bool: ...


class AsyncQuestions(_Watching):
    """The same for asyncio."""

    async def peers(self) -> list[PeerInfo]:
        """Return every node ever heard by the daemon."""
        return peers_of(await self._ask("peers"))

    async def stats(self) -> dict[str, object]:
        """Return the daemon's counters, queue depths and peers."""
        return table_of(await self._ask("stats"))

    async def config_get(self) -> dict[str, object]:
        """Return the daemon's settings."""
        return table_of(await self._ask("config_get"))

    async def config_set(self, key: str, value: str) -> dict[str, object]:
        """Change a setting while the daemon runs; return all settings."""
        return table_of(await self._ask("config_set", key=key, value=value))

    async def wait_for_peer(self, name: str, timeout_s: float) -> bool:
        """Wait until a peer is online; False if it was not within ``timeout_s``."""
        return await self._wait(lambda: self._state.is_online(name), timeout_s)

    async def wait_for_status(self, timeout_s: float | None = None) -> Status | None:
        """Wait for the next state; None if there was none within ``timeout_s``."""
        before = self._state.status
        await self._wait(lambda: self._state.status is not before, timeout_s)
        return None if self._state.status is before else self._state.status

    @abstractmethod
    async def _ask(self, method: str, **arguments: str) -> object: ...

    @abstractmethod
    async def _wait(self, is_done: Callable[[], bool], timeout_s: float | None) -> bool: ...
