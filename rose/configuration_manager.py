"""The Configuration Manager: one file for many hosts, handed to their Service Managers until each has taken it.

A host that is away gets its part when it is back; one that announces another version than the file's is told again.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

import msgspec

from rose.config.model import HostConfig, TeamConfig
from rose.core.addressing import ServiceId
from rose.core.messages import ConfigureHost, Done, HostState
from rose.core.types import decode_message, info_of
from rose.core.wire import Header
from rose.errors import CallError, TypeMismatchError
from rose.manager import version_of
from rose.service import Service

TRY_S = 2.0


class ConfigurationManager:
    """Configures a team from :meth:`start` to :meth:`close`."""

    def __init__(self, team: TeamConfig, say: Callable[[str], None]) -> None:
        """``say`` takes a line for a person whenever a host has taken its part or refused it."""
        self._team, self._say = team, say
        self._service = Service(team.sid, keys=team.keys, fresh_s=team.fresh_s)
        self._waiting = {config.manager for config in team.hosts.values()}
        self._said: dict[ServiceId, str] = {}
        self._tasks: dict[ServiceId, asyncio.Task[None]] = {}
        self._all_done = asyncio.Event()

    async def start(self) -> None:
        """Begin to ask; returns at once.

        Raises:
            RoseError: Its own service id is taken on this host.
        """
        await self._service.start()
        self._service.on_announcement(self._hear)
        for config in self._team.hosts.values():
            self._tell(config)

    async def close(self) -> None:
        """End."""
        for task in self._tasks.values():
            task.cancel()
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)
        await self._service.close()

    async def wait(self, timeout_s: float | None = None) -> set[ServiceId]:
        """Return the managers that have not taken their part when all have, or the time is over."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._all_done.wait(), timeout_s)
        return set(self._waiting)

    def _tell(self, config: HostConfig) -> None:
        task = self._tasks.get(config.manager)
        if task is None or task.done():
            self._tasks[config.manager] = asyncio.create_task(self._until_taken(config))

    async def _until_taken(self, config: HostConfig) -> None:
        manager = config.manager
        services = [msgspec.to_builtins(service) for service in config.services]
        command = ConfigureHost(version_of(config.services), services)
        while True:
            try:
                await self._service.call(manager, command, Done, timeout_s=TRY_S)
                break
            except CallError as error:
                self._say_once(manager, str(error))
                await asyncio.sleep(TRY_S)
        self._say_once(manager, f"{manager} runs version {command.version}")
        self._waiting.discard(manager)
        if not self._waiting:
            self._all_done.set()

    def _say_once(self, manager: ServiceId, line: str) -> None:
        if self._said.get(manager) != line:
            self._said[manager] = line
            self._say(line)

    def _hear(self, header: Header, payload: bytes) -> None:
        config = self._team.hosts.get(header.sender.host)
        if config is None or header.sender != config.manager or header.type_id != info_of(HostState).type_id:
            return
        try:
            state = decode_message(payload, HostState)
        except TypeMismatchError:
            return
        assert isinstance(state, HostState)
        if state.version != version_of(config.services):
            self._waiting.add(config.manager)
            self._tell(config)
