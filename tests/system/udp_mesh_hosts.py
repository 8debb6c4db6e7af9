"""Hosts for tests of the real daemon: network namespaces, wires between them, a slow serial line."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from udp_mesh.client import Client

HOLDER = "ip link set lo up; echo up; exec cat"


class Host:
    """A network namespace, held by a process, in which one daemon runs."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        self.socket = str(folder / f"{name}.sock")
        self.events = folder / f"{name}.events"
        self.config = folder / f"{name}.toml"
        self.daemon: subprocess.Popen[bytes] | None = None
        words = ["unshare", "--net", "sh", "-c", HOLDER]
        self.holder = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self.holder.stdout is not None
        assert self.holder.stdout.readline() == b"up\n"
        self.enter = ["nsenter", f"--net=/proc/{self.holder.pid}/ns/net"]

    def ip(self, *words: str) -> None:
        subprocess.run([*self.enter, "ip", *words], check=True)

    def start(self, extra: str) -> None:
        """Start the daemon with these further lines of configuration and wait until it is ready."""
        self.config.write_text(f'name = "{self.name}"\nsocket = "{self.socket}"\n{extra}')
        ready_read, ready_write = os.pipe()
        with self.events.open("ab") as events:
            argv = [*self.enter, sys.executable, "-m", "udp_mesh", "daemon", "--config", str(self.config)]
            argv += ["--ready-fd", str(ready_write), "--events-fd", str(events.fileno())]
            self.daemon = subprocess.Popen(argv, pass_fds=[ready_write, events.fileno()])
        os.close(ready_write)
        with os.fdopen(ready_read, "rb") as ready:
            assert ready.read() == b"READY=1\n"

    def happened(self, name: str) -> list[dict[str, object]]:
        """Return the daemon's events of this name."""
        read = [json.loads(line) for line in self.events.read_text().splitlines()]
        return [event for event in read if event["event"] == name]

    def close(self) -> None:
        if self.daemon is not None:
            self.daemon.send_signal(signal.SIGKILL)
            self.daemon.wait(timeout=5)
        assert self.holder.stdin is not None
        assert self.holder.stdout is not None
        self.holder.stdin.close()
        self.holder.stdout.close()
        self.holder.wait(timeout=5)


@contextlib.contextmanager
def separate_hosts(folder: Path, *names: str) -> Iterator[list[Host]]:
    """Hosts that nothing joins yet; without root the test is skipped."""
    if os.geteuid() != 0:
        pytest.skip("makes network namespaces and devices of its own: run it as root, or in `netlab vm`")
    with contextlib.ExitStack() as stack:
        made = []
        for name in names:
            made.append(Host(name, folder))
            stack.callback(made[-1].close)
        yield made


def join(a: Host, b: Host, name: str, *, network: str = "", mtu: int = 1500) -> None:
    """Join two hosts by a veth; with ``network`` (three numbers) it has IPv4, always IPv6 without waiting."""
    a.ip("link", "add", name, "type", "veth", "peer", "name", name, "netns", str(b.holder.pid))
    for number, host in enumerate((a, b), start=1):
        if network:
            host.ip("address", "add", f"{network}.{number}/24", "broadcast", f"{network}.255", "dev", name)
        subprocess.run([*host.enter, "sh", "-c", f"echo 0 > /proc/sys/net/ipv6/conf/{name}/accept_dad"], check=True)
        host.ip("link", "set", name, "mtu", str(mtu), "up")


def exchange(a: Host, b: Host, *, sizes: tuple[int, ...] = (0, 100, 1399, 300_000), timeout_s: float = 20.0) -> Client:
    """Send messages of these sizes to beta and one broadcast; return the sender's client, open."""
    sender = Client(a.socket)
    with Client(b.socket) as receiver:
        receiver.subscribe("t")
        receiver.stats()
        assert sender.wait_for_peer(b.name, timeout_s)
        for size in sizes:
            payload = os.urandom(size)
            sender.publish_wait("t", payload, to=b.name)
            message = receiver.receive(timeout_s=timeout_s)
            assert message is not None
            assert message.payload == payload
        sender.publish("t", b"to everybody", to="all")
        message = receiver.receive(timeout_s=timeout_s)
        assert message is not None
        assert message.payload == b"to everybody"
    return sender


class Line(threading.Thread):
    """Joins two pseudo-terminals; each direction carries so many bits per second, in order, ten to a byte."""

    def __init__(self, first: int, second: int, *, rate_bps: float) -> None:
        super().__init__(daemon=True)
        self._ends = {first: second, second: first}
        self._byte_s = 8 / rate_bps
        self._free_at_s = dict.fromkeys(self._ends, 0.0)
        self._is_ended = threading.Event()

    def run(self) -> None:
        while not self._is_ended.is_set():
            now = time.monotonic()
            ready = [end for end in self._ends if self._free_at_s[end] <= now]
            for end in select.select(ready, [], [], 0.005)[0]:
                with contextlib.suppress(OSError):
                    data = os.read(end, 16)
                    os.write(self._ends[end], data)
                    self._free_at_s[end] = max(self._free_at_s[end], now) + len(data) * self._byte_s

    def end(self) -> None:
        self._is_ended.set()
        self.join()
