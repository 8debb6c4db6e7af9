"""The Service Manager: a service (0.0 of its host) that runs all others of the host.

It needs nobody: with a configuration file a host comes up whole without a network. Where its file says so, a
Configuration Manager that has a key may replace the services over the network; what it sent is kept beside the file and
taken at the next start, so that the host then needs nobody again.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import sys
from pathlib import Path

import msgspec

from rose.changes import changes
from rose.config.model import MANAGER, HostConfig, ServiceConfig
from rose.core.addressing import ServiceId
from rose.core.messages import AskHost, ConfigureHost, Done, HostState
from rose.core.types import Message
from rose.errors import RoseError
from rose.io.udp import UdpTransport
from rose.service import Command, Service
from rose.supervision import Supervised

ANNOUNCE_S = 1.0


def version_of(services: tuple[ServiceConfig, ...]) -> str:
    """Return a name for a host's configuration: the same services have the same one."""
    return hashlib.sha256(msgspec.json.encode(services, order="sorted")).hexdigest()[:16]


class ServiceManager:
    """One host's services, from :meth:`start` to :meth:`close`."""

    def __init__(self, config: HostConfig, *, kept: Path | None = None) -> None:
        """``kept``: where what comes over the network is kept, and taken from at the start."""
        self._config = config
        self._kept = kept if config.accepts else None
        self._service = Service(config.manager, transport=UdpTransport(), keys=config.keys, fresh_s=config.fresh_s)
        self._supervised: dict[tuple[int, int], Supervised] = {}
        self._services: tuple[ServiceConfig, ...] = ()
        self._changing = asyncio.Lock()
        self._announcing: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Start every service; returns when each runs or has failed to.

        Raises:
            RoseError: Another Service Manager runs on this host.
        """
        await self._service.start()
        self._service.on_command_from(ConfigureHost, self._configure_host)
        self._service.on_command_from(AskHost, self._answer_state)
        self._announcing = asyncio.create_task(self._announce())
        await self._run(self._read_kept() or self._config.services)
        for supervised in tuple(self._supervised.values()):
            await supervised.settled()

    async def close(self) -> None:
        """Stop every service."""
        if self._announcing is not None:
            self._announcing.cancel()
            await asyncio.gather(self._announcing, return_exceptions=True)
        await asyncio.gather(*(supervised.stop() for supervised in self._supervised.values()))
        await self._service.close()

    def state(self) -> HostState:
        """Return how the host's services stand."""
        described = [self._supervised[numbers].describe() for numbers in sorted(self._supervised)]
        return HostState(version_of(self._services), described)

    # -- inside ---------------------------------------------------------------------------------------------------

    async def _run(self, services: tuple[ServiceConfig, ...]) -> None:
        async with self._changing:
            what = changes(self._services, services)
            self._services = services
            await asyncio.gather(*(self._supervised.pop(_numbers(config)).stop() for config in what.stop))
            for config in what.start:
                self._supervised[_numbers(config)] = Supervised(
                    config, self._service, self._config.keys, self._config.fresh_s, _say
                )
            await asyncio.gather(*(self._supervised[_numbers(config)].configure(config) for config in what.configure))

    async def _configure_host(self, command: Command) -> Message:
        if not self._config.accepts:
            raise RoseError("takes no configuration over the network; set accept_configuration: true in its file")
        assert isinstance(command.message, ConfigureHost)
        services = _services_of(command.message.services, self._config.manager)
        await self._run(services)
        if self._kept is not None:
            _write_whole(self._kept, msgspec.json.encode(services))
        return Done()

    async def _answer_state(self, _command: Command) -> Message:
        return self.state()

    async def _announce(self) -> None:
        while True:
            self._service.publish(self.state())
            self._service.announce(self.state())
            await asyncio.sleep(ANNOUNCE_S)

    def _read_kept(self) -> tuple[ServiceConfig, ...] | None:
        if self._kept is None or not self._kept.exists():
            return None
        try:
            return msgspec.json.decode(self._kept.read_bytes(), type=tuple[ServiceConfig, ...])
        except (OSError, msgspec.DecodeError) as error:
            _say(f"{self._kept}: is damaged and not used: {error}")
            return None


def _services_of(values: list[dict[str, object]], manager: ServiceId) -> tuple[ServiceConfig, ...]:
    try:
        services = msgspec.convert(values, tuple[ServiceConfig, ...])
    except msgspec.ValidationError as error:
        raise RoseError(f"no configuration: {error}") from None
    for config in services:
        ServiceId(manager.host, config.robot, config.service)  # within the limits, or an AddressError for the caller
        if _numbers(config) == MANAGER:
            raise RoseError("0.0 is the Service Manager's own")
    if len({_numbers(config) for config in services}) < len(services):
        raise RoseError("two services have the same numbers")
    return services


def _numbers(config: ServiceConfig) -> tuple[int, int]:
    return config.robot, config.service


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _write_whole(path: Path, content: bytes) -> None:
    """Replace a file so that it is the old or the new one, whenever the power goes."""
    beside = path.with_suffix(path.suffix + ".new")
    with beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
