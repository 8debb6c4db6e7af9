"""The command ``rose``. Every command parses, asks services, prints; keys and the own address come from a file."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable, Coroutine
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import click

from rose import commands
from rose.config.model import HostConfig, load_host, load_team, team_collisions
from rose.core.addressing import ServiceId
from rose.core.keys import KEY_BYTES
from rose.errors import RoseError

_FILE = click.Path(path_type=Path, dir_okay=False)


def main() -> None:
    """Run one command; exit code 0, 1 (nobody there, refused) or 2 (wrong use or configuration)."""
    try:
        rose(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except (KeyboardInterrupt, click.Abort):
        sys.exit(130)
    except RoseError as error:
        click.echo(f"rose: {error}" if not getattr(error, "problems", None) else str(error), err=True)
        sys.exit(2 if getattr(error, "problems", None) else 1)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def rose() -> None:
    """Robot services over multicast."""


def _as_host(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that say who this command is on the network."""
    command = click.option(
        "--types", multiple=True, metavar="MODULE", help="Import this module first: it knows message types."
    )(command)
    command = click.option(
        "--config", "config", type=_FILE, envvar="ROSE_CONFIG", help="A host's file, for its address and its keys."
    )(command)
    return click.option("--host", help="The own address, where several networks could be meant.")(command)


def _run(work: Coroutine[Any, Any, int]) -> None:
    status = asyncio.run(work)
    if status:
        sys.exit(status)


def _identity(host: str | None, config: Path | None, types: tuple[str, ...]) -> HostConfig:
    commands.import_types(types)
    if config is not None:
        return load_host(config)
    try:
        return HostConfig(ip_address(host) if host else commands.own_address(), ())
    except ValueError:
        raise click.UsageError(f"--host {host} is no IP address") from None


@rose.command()
@click.argument("file", type=_FILE)
@click.option("--ready-fd", type=int, envvar="READY_FD", help="Say so there when every service runs.")
def run(file: Path, ready_fd: int | None) -> None:
    """Run the services of FILE on this host (its Service Manager) until Ctrl-C or SIGTERM."""
    _run(commands.run_host(load_host(file), kept=file.with_suffix(".kept.json"), ready_fd=ready_fd))


@rose.command("list")
@_as_host
@click.option("--wait", "wait_s", type=click.FloatRange(0.1, 3600), default=2.5, show_default=True, help="Seconds.")
@click.option("--json", "as_json", is_flag=True, help="One object per host and line.")
def list_services(host: str | None, config: Path | None, types: tuple[str, ...], wait_s: float, as_json: bool) -> None:
    """List the hosts that announce themselves, and their services."""
    _run(commands.list_hosts(_identity(host, config, types), wait_s=wait_s, as_json=as_json))


@rose.command()
@click.argument("service")
@_as_host
@click.option("--count", type=click.IntRange(0), default=0, help="End after so many messages.")
@click.option("--json", "as_json", is_flag=True, help="One object per line.")
def echo(
    service: str, host: str | None, config: Path | None, types: tuple[str, ...], count: int, as_json: bool
) -> None:
    """Print what SERVICE publishes, such as 10.0.0.114/0.1."""
    _run(commands.echo(_identity(host, config, types), ServiceId.parse(service), count=count, as_json=as_json))


@rose.command()
@click.argument("service")
@click.argument("kind", metavar="TYPE")
@click.argument("values", default="[]")
@_as_host
@click.option("--timeout", "timeout_s", type=click.FloatRange(0.01, 3600), default=2.0, show_default=True)
def call(
    service: str,
    kind: str,
    values: str,
    host: str | None,
    config: Path | None,
    types: tuple[str, ...],
    timeout_s: float,
) -> None:
    """Give SERVICE a command: its TYPE and its fields as JSON, such as example/set_rate '{"rate_hz": 5}'."""
    who = _identity(host, config, types)
    _run(commands.call(who, ServiceId.parse(service), kind, values, timeout_s=timeout_s))


@rose.command()
def key() -> None:
    """Print a new key."""
    click.echo(os.urandom(KEY_BYTES).hex())


@rose.group()
def config() -> None:
    """Check a configuration, or hand one to many hosts."""


@config.command()
@click.argument("file", type=_FILE)
@click.option("--team", is_flag=True, help="It is a Configuration Manager's file, with many hosts.")
def check(file: Path, team: bool) -> None:
    """Report every mistake in FILE, and the addresses that follow from it."""
    if not team:
        commands.print_addresses([load_host(file)])
        return
    loaded = load_team(file)
    commands.print_addresses(list(loaded.hosts.values()))
    for one, other in team_collisions(loaded):
        click.echo(f"warning: {one} and {other} share the group {one.group}; give one host another last byte", err=True)


@config.command()
@click.argument("file", type=_FILE)
@click.option("--wait", "wait_s", type=click.FloatRange(0.1), default=10.0, show_default=True, help="Seconds.")
@click.option("--stay", is_flag=True, help="Go on, and configure hosts that come back with something else.")
def push(file: Path, wait_s: float, stay: bool) -> None:
    """Hand FILE, which has many hosts, to their Service Managers. Exit code 1 if not all have taken it."""
    _run(commands.push(load_team(file), wait_s=None if stay else wait_s))
