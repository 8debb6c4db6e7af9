"""What the tests of faults share: three hosts on one bridge, and a daemon whose store lies on a small disk."""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.system.test_udp_mesh_io import Host, _privileges

#: Runs its arguments with a small disk at $1, of size $2, that goes when they end.
SMALL_DISK = 'mount -t tmpfs -o size="$2" none "$1" && shift 2 && exec "$@"'


def events(host: Host, name: str = "") -> list[dict[str, Any]]:
    """What a host's daemon has reported, of one kind or all."""
    every = [json.loads(line) for line in host.events.read_text().splitlines()]
    return [event for event in every if name in ("", event["event"])]


@contextlib.contextmanager
def bridged(folder: Path, names: tuple[str, ...]) -> Iterator[list[Host]]:
    """Hosts of these names on one Ethernet; a name that comes twice gets two hosts."""
    with contextlib.ExitStack() as stack:
        privileges = stack.enter_context(_privileges())
        hub = Host("hub", folder, privileges)
        stack.callback(hub.close)
        hub.ip("link", "add", "hub0", "type", "bridge")
        hub.ip("link", "set", "hub0", "up")
        hosts = []
        for number, name in enumerate(names, start=1):
            own = folder / str(number)
            own.mkdir()
            host = Host(name, own, privileges)
            stack.callback(host.close)
            host.ip("link", "add", "mesh0", "type", "veth", "peer", "name", f"port{number}", "netns", str(hub.pid))
            host.ip("address", "add", f"10.9.0.{number}/24", "broadcast", "10.9.0.255", "dev", "mesh0")
            host.ip("link", "set", "mesh0", "up")
            hub.ip("link", "set", f"port{number}", "master", "hub0", "up")
            hosts.append(host)
        yield hosts


def on_small_disk(host: Host, folder: Path, size: str) -> None:
    """Let a host's daemon keep its store on a disk of this size, as tmpfs(5) takes it."""
    folder.mkdir()
    host.config.write_text(host.config.read_text() + f'store = "{folder}/store.db"\n')
    host.prefix = ["unshare", "--mount", "sh", "-c", SMALL_DISK, "sh", str(folder), size]


def resize(host: Host, folder: Path, size: str) -> None:
    """Make that disk larger while the daemon runs."""
    assert host.daemon is not None
    enter = [*host.privileges, "nsenter", f"--mount=/proc/{host.daemon.pid}/ns/mnt"]
    subprocess.run([*enter, "mount", "-o", f"remount,size={size}", "none", str(folder)], check=True)
