"""What the commands of ``rose`` do, once their words are read."""

from __future__ import annotations

import asyncio
import importlib
import os
import random
import signal
import socket
from ipaddress import IPv4Address, ip_address
from pathlib import Path
from typing import Any

import click
import msgspec

from rose.config.model import HostConfig, TeamConfig
from rose.configuration_manager import ConfigurationManager
from rose.core.addressing import ANNOUNCE_PORT, ROBOTS_PER_HOST, SERVICES_PER_ROBOT, Host, ServiceId, announce_group
from rose.core.messages import Done, HostState
from rose.core.reception import Sample
from rose.core.types import AnyMessage, Message, decode_message, info_of, known_names, known_type, type_id
from rose.core.wire import Header
from rose.errors import CallError, RoseError, TypeMismatchError
from rose.manager import ServiceManager
from rose.service import Service

#: Commands are services too while they run: the last robot's, one of these that is free.
_TOOL_ROBOT = ROBOTS_PER_HOST - 1
_TOOL_TRIES = 20


def import_types(modules: tuple[str, ...]) -> None:
    """Import the modules that know message types, the examples' first.

    Raises:
        RoseError: There is no such module.
    """
    for module in ("rose.examples.messages", *modules):
        try:
            importlib.import_module(module)
        except ImportError as error:
            raise RoseError(f"--types {module}: {error}") from None


def own_address() -> Host:
    """Return the address by which this host would send to the group of announcements.

    Raises:
        RoseError: It has no network.
    """
    group = announce_group(IPv4Address("10.0.0.1"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.connect((str(group), ANNOUNCE_PORT))  # sends nothing
        except OSError:
            raise RoseError("no route for multicast; say which address is meant: --host or --config") from None
        return ip_address(sock.getsockname()[0])


async def run_host(config: HostConfig, *, kept: Path, ready_fd: int | None) -> int:
    """Run a host's services until SIGTERM or SIGINT."""
    stopping = asyncio.Event()
    for signum in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(signum, stopping.set)
    manager = ServiceManager(config, kept=kept)
    starting, ending = asyncio.create_task(manager.start()), asyncio.create_task(stopping.wait())
    try:
        await asyncio.wait([starting, ending], return_when=asyncio.FIRST_COMPLETED)
        if not starting.done():
            return 0
        starting.result()
        for state in manager.state().services:
            click.echo(f"{state.sid} {state.name}: {state.state}{state.detail and ', ' + state.detail}", err=True)
        if ready_fd is not None:
            os.write(ready_fd, b"ready\n")
            os.close(ready_fd)
        await ending
    finally:
        starting.cancel()
        await asyncio.gather(starting, return_exceptions=True)
        await manager.close()
    return 0


async def list_hosts(who: HostConfig, *, wait_s: float, as_json: bool) -> int:
    """Print who announces itself within ``wait_s``; 1 if nobody does."""
    found: dict[ServiceId, HostState] = {}

    def hear(header: Header, payload: bytes) -> None:
        if header.type_id == info_of(HostState).type_id:
            try:
                state = decode_message(payload, HostState)
            except TypeMismatchError:
                return
            assert isinstance(state, HostState)
            found[header.sender] = state

    service = await _tool(who)
    try:
        service.on_announcement(hear)
        await asyncio.sleep(wait_s)
    finally:
        await service.close()
    for manager, state in sorted(found.items()):
        _print_host(manager, state, as_json=as_json)
    if not found:
        faults = "".join(f"; {count} datagrams dropped: {fault}" for fault, count in service.faults.items())
        click.echo(f"nobody announces a host on {service.sid.host}'s network within {wait_s:g} s{faults}", err=True)
    return 0 if found else 1


async def echo(who: HostConfig, sender: ServiceId, *, count: int, as_json: bool) -> int:
    """Print what a service publishes."""
    service = await _tool(who)
    try:
        samples = service.subscribe(sender, AnyMessage)
        printed = 0
        async for sample in samples:
            click.echo(_sample_json(sample) if as_json else _sample_text(sample))
            printed += 1
            if printed == count:
                break
    finally:
        await service.close()
    return 0


async def call(who: HostConfig, to: ServiceId, kind: str, values: str, *, timeout_s: float) -> int:
    """Give a service a command and print its answer; 1 if it refuses or does not answer."""
    info = known_type(type_id(kind))
    if info is None:
        raise RoseError(f"type '{kind}' is not known; known are {', '.join(known_names())}; --types imports more")
    try:
        command = _from_json(values, info.cls)
    except (msgspec.DecodeError, msgspec.ValidationError) as error:
        raise RoseError(
            f"{values}: no {kind}: {error}; its fields are {', '.join(info.cls.__struct_fields__)}"
        ) from None
    service = await _tool(who)
    try:
        answer = await service.call(to, command, AnyMessage, timeout_s=timeout_s, local=to.host == who.host)
    except CallError as error:
        click.echo(str(error), err=True)
        return 1
    finally:
        await service.close()
    click.echo("done" if isinstance(answer, Done) else _json(_named(answer)))
    return 0


async def push(team: TeamConfig, *, wait_s: float | None) -> int:
    """Configure a team; 1 if somebody has not taken it in time."""
    manager = ConfigurationManager(team, click.echo)
    await manager.start()
    try:
        if wait_s is None:
            await asyncio.Event().wait()
        missing = await manager.wait(wait_s)
    finally:
        await manager.close()
    for sid in sorted(missing):
        click.echo(f"{sid} has not taken its configuration", err=True)
    return 1 if missing else 0


def print_addresses(hosts: list[HostConfig]) -> None:
    """Print what follows from the ids of configured services."""
    for host in hosts:
        for service in host.services:
            sid = ServiceId(host.host, service.robot, service.service)
            click.echo(f"{sid!s:<24} {service.name:<16} port {sid.port:<6} group {sid.group}")


# -- inside -------------------------------------------------------------------------------------------------------


async def _tool(who: HostConfig) -> Service:
    """A service for as long as a command runs."""
    numbers = random.sample(range(SERVICES_PER_ROBOT), _TOOL_TRIES)
    for number in numbers[:-1]:
        try:
            return await Service(ServiceId(who.host, _TOOL_ROBOT, number), keys=who.keys, fresh_s=who.fresh_s).start()
        except RoseError:
            continue
    return await Service(ServiceId(who.host, _TOOL_ROBOT, numbers[-1]), keys=who.keys).start()


def _print_host(manager: ServiceId, state: HostState, *, as_json: bool) -> None:
    if as_json:
        click.echo(
            _json(
                {
                    "host": str(manager.host),
                    **msgspec.structs.asdict(state),
                    "services": [msgspec.structs.asdict(service) for service in state.services],
                }
            )
        )
        return
    click.echo(f"{manager.host}  configuration {state.version}")
    for service in state.services:
        again = f", restarted {service.restarts} times" if service.restarts else ""
        detail = f": {service.detail}" if service.detail else ""
        click.echo(f"  {service.sid:<24} {service.name:<16} {service.state}{again}{detail}")


def _sample_text(sample: Sample) -> str:
    lost = f"  ({sample.lost_before} lost before)" if sample.lost_before else ""
    part = f"  ({sample.completeness:.0%} of it)" if sample.completeness < 1.0 else ""
    return f"#{sample.sequence} {_json(_named(sample.message))}{lost}{part}"


def _sample_json(sample: Sample) -> str:
    return _json(
        {
            "sender": str(sample.sender),
            "sequence": sample.sequence,
            "age_s": sample.age_s,
            "lost_before": sample.lost_before,
            "completeness": sample.completeness,
            "missing": sample.missing,
            "message": _named(sample.message),
        }
    )


def _named(value: object) -> object:
    """A message by its fields' names, also inside others, where its type is known; else its plain values."""
    if isinstance(value, AnyMessage):
        return value.value
    if isinstance(value, Message):
        return {name: _named(getattr(value, name)) for name in value.__struct_fields__}
    return [_named(item) for item in value] if isinstance(value, list) else value


def _from_json(text: str, cls: type[Message]) -> Message:
    """A message from a JSON array of its fields, or an object by their names."""
    values: Any = msgspec.json.decode(text)
    if isinstance(values, dict):
        unknown = set(values) - set(cls.__struct_fields__)
        if unknown:
            raise msgspec.ValidationError(f"there is no field {', '.join(sorted(unknown))}")
        return cls(**{name: msgspec.convert(value, _field_type(cls, name)) for name, value in values.items()})
    return msgspec.convert(values, cls)


def _field_type(cls: type[Message], name: str) -> Any:
    return next(field.type for field in msgspec.structs.fields(cls) if field.name == name)


def _json(value: object) -> str:
    return msgspec.json.encode(value, enc_hook=str).decode()
