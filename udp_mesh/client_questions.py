"""What both clients can ask their daemon about itself."""

from __future__ import annotations

from abc import ABC, abstractmethod

from udp_mesh.client_types import PeerInfo, peers_of, table_of


class Questions(ABC):
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

    @abstractmethod
    def _ask(self, method: str, **arguments: str) -> object: ...


class AsyncQuestions(ABC):
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

    @abstractmethod
    async def _ask(self, method: str, **arguments: str) -> object: ...
