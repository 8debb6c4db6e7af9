"""Two real daemons in two network namespaces joined by a veth, and what loads them. Nothing stays behind.

As a program it is one of the applications: ``udp_mesh_rig.py ROLE ARGUMENTS``; each prints one JSON object.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from udp_mesh.client import AsyncClient, Client

TICKS_PER_S = os.sysconf("SC_CLK_TCK")
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
TOPIC = "bench"
ADDRESSES = ("10.9.0.1", "10.9.0.2")
_UDP_SEGMENT = 103
_UDP_GRO = 104


@dataclass(slots=True)
class Host:
    """A network namespace, the words that enter it, and the daemon that runs in it."""

    name: str
    enter: list[str]
    namespace_pid: int
    socket_path: str
    config: Path
    daemon: subprocess.Popen[bytes] | None = None

    def start(self) -> float:
        """Start the daemon; return the seconds until it reported ready."""
        ready_read, ready_write = os.pipe()
        began_s = time.monotonic()
        command = [*self.enter, sys.executable, "-m", "udp_mesh", "daemon"]
        self.daemon = subprocess.Popen(
            [*command, "--config", str(self.config), "--ready-fd", str(ready_write)], pass_fds=[ready_write]
        )
        os.close(ready_write)
        with os.fdopen(ready_read, "rb") as ready:
            if ready.read() != b"READY=1\n":
                raise RuntimeError(f"the daemon of {self.name} did not start")
        return time.monotonic() - began_s

    def stop(self) -> None:
        """End the daemon."""
        if self.daemon is not None:
            self.daemon.terminate()
            self.daemon.wait(timeout=10)
            self.daemon = None

    @property
    def pid(self) -> int:
        """The daemon's process id."""
        assert self.daemon is not None
        return self.daemon.pid


def cpu_s(pid: int) -> float:
    """Return the CPU time that a process has used, in seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE_BYTES


@contextlib.contextmanager
def hosts(count: int = 2, config: str = "") -> Iterator[list[Host]]:
    """Yield hosts on one segment: two joined by a veth, more by a bridge in the first one's namespace."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        privileges = stack.enter_context(_privileges())
        made = [_namespace(f"node{n + 1}", folder, config, privileges, stack) for n in range(count)]
        first = made[0]
        if count > 2:
            _ip(first, "link add br0 address 02:00:00:00:00:01 type bridge")  # the same whatever its ports are
            _ip(first, "link set br0 up")
        for number, host in enumerate(made[1:], start=2):
            near = "mesh0" if count == 2 else f"port{number}"
            _ip(first, f"link add {near} type veth peer name mesh0 netns {host.namespace_pid}")
            if count > 2:
                _ip(first, f"link set {near} master br0 up")
        for number, host in enumerate(made, start=1):
            device = "br0" if count > 2 and number == 1 else "mesh0"
            _ip(host, f"address add 10.9.0.{number}/24 broadcast 10.9.0.255 dev {device}")
            _ip(host, f"link set {device} up")
        for host in made:
            stack.callback(host.stop)
        yield made


def cut(made: list[Host], number: int, *, active: bool) -> None:
    """Lose everything between one host (the second is number 2) and all others silently, or end that; needs a bridge.

    Its carrier stays up: the bridge's port is only taken out of the bridge.
    """
    _ip(made[0], f"link set port{number} " + ("nomaster" if active else "master br0"))


@contextlib.contextmanager
def _privileges() -> Iterator[list[str]]:
    if os.geteuid() == 0:
        yield []
        return
    with _holder(["unshare", "--user", "--map-root-user"]) as pid:
        yield ["nsenter", f"--user=/proc/{pid}/ns/user", "--preserve-credentials"]


@contextlib.contextmanager
def _holder(words: list[str]) -> Iterator[int]:
    """A process that only keeps its namespaces alive."""
    process = subprocess.Popen(
        [*words, "sh", "-c", "ip link set lo up 2>/dev/null; echo $$; exec cat"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with process:
        assert process.stdout is not None
        yield int(process.stdout.readline())


def _namespace(name: str, folder: Path, config: str, privileges: list[str], stack: contextlib.ExitStack) -> Host:
    pid = stack.enter_context(_holder([*privileges, "unshare", "--net"]))
    path = folder / f"{name}.toml"
    path.write_text(f'name = "{name}"\nsocket = "{folder}/{name}.sock"\n{config}')
    return Host(name, [*privileges, "nsenter", f"--net=/proc/{pid}/ns/net"], pid, f"{folder}/{name}.sock", path)


def _ip(host: Host, words: str) -> None:
    subprocess.run([*host.enter, "ip", *words.split()], check=True)


# -- applications


def _usage_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def publish(socket_path: str, to: str, size_bytes: int, count: int) -> dict[str, float]:
    """Publish as fast as the daemon takes it."""
    payload = os.urandom(size_bytes)
    with Client(socket_path) as client:
        assert client.wait_for_peer(to, 5.0)
        _say_ready()
        used_s = _usage_s()
        for _ in range(count):
            client.publish_wait(TOPIC, payload, to=to, timeout_s=60.0)
        return {"cpu_s": _usage_s() - used_s}


def subscribe(socket_path: str, count: int) -> dict[str, float]:
    """Receive ``count`` messages, less what this application was too slow for."""
    with Client(socket_path) as client:
        client.subscribe(TOPIC)
        client.stats()
        _say_ready()
        used_s, size_bytes, received = _usage_s(), 0, 0
        while received + client.missed < count:
            message = client.receive(timeout_s=60.0)
            assert message is not None
            size_bytes += len(message.payload)
            received += 1
        return _received(used_s, size_bytes, client.missed)


async def publish_async(socket_path: str, to: str, size_bytes: int, count: int) -> dict[str, float]:
    """As :func:`publish`, with asyncio."""
    payload = os.urandom(size_bytes)
    async with AsyncClient(socket_path) as client:
        assert await client.wait_for_peer(to, 5.0)
        _say_ready()
        used_s = _usage_s()
        for _ in range(count):
            await client.publish_wait(TOPIC, payload, to=to, timeout_s=60.0)
        return {"cpu_s": _usage_s() - used_s}


async def subscribe_async(socket_path: str, count: int) -> dict[str, float]:
    """As :func:`subscribe`, with asyncio."""
    async with AsyncClient(socket_path) as client:
        await client.subscribe(TOPIC)
        await client.stats()
        _say_ready()
        used_s, size_bytes, received = _usage_s(), 0, 0
        while received + client.missed < count:
            message = await client.receive(timeout_s=60.0)
            assert message is not None
            size_bytes += len(message.payload)
            received += 1
        return _received(used_s, size_bytes, client.missed)


def _received(used_s: float, size_bytes: int, missed: int) -> dict[str, float]:
    return {"cpu_s": _usage_s() - used_s, "bytes": size_bytes, "ended_s": time.monotonic(), "missed": missed}


def udp_send(size_bytes: int, duration_s: float) -> dict[str, float]:
    """Send segmented bursts without any protocol."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect((ADDRESSES[1], 9))
        sock.setsockopt(socket.IPPROTO_UDP, _UDP_SEGMENT, size_bytes)
        burst = bytes(size_bytes * 44)
        _say_ready()
        used_s, until_s = _usage_s(), time.monotonic() + duration_s
        while time.monotonic() < until_s:
            with contextlib.suppress(ConnectionRefusedError):
                sock.send(burst)
        return {"cpu_s": _usage_s() - used_s}


def udp_receive(duration_s: float) -> dict[str, float]:
    """Count what arrives within the time."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.IPPROTO_UDP, _UDP_GRO, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 * 1024 * 1024)
        sock.bind(("", 9))
        _say_ready()
        sock.settimeout(5.0)
        received, began_s, used_s = len(sock.recv(65536)), time.monotonic(), _usage_s()
        while time.monotonic() - began_s < duration_s * 0.9:
            received += len(sock.recv(65536))
        return {"bytes": received, "elapsed_s": time.monotonic() - began_s, "cpu_s": _usage_s() - used_s}


def tcp_send(size_bytes: int, duration_s: float) -> dict[str, float]:
    """Stream over TCP."""
    with socket.create_connection((ADDRESSES[1], 9)) as sock:
        payload = bytes(size_bytes)
        _say_ready()
        used_s, until_s = _usage_s(), time.monotonic() + duration_s
        while time.monotonic() < until_s:
            sock.sendall(payload)
        return {"cpu_s": _usage_s() - used_s}


def tcp_receive() -> dict[str, float]:
    """Read a TCP stream to its end."""
    with socket.create_server(("", 9)) as server:
        _say_ready()
        sock, _address = server.accept()
        buffer, received, began_s, used_s = bytearray(1 << 20), 0, time.monotonic(), _usage_s()
        while size := sock.recv_into(buffer):
            received += size
        return {"bytes": received, "elapsed_s": time.monotonic() - began_s, "cpu_s": _usage_s() - used_s}


def _say_ready() -> None:
    print("ready", flush=True)


class Application:
    """One of the above as a process."""

    def __init__(self, role: str, *arguments: object, enter: list[str] | None = None) -> None:
        words = [*(enter or []), sys.executable, __file__, role, *map(str, arguments)]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE)
        assert self.process.stdout is not None
        if self.process.stdout.readline() != b"ready\n":
            raise RuntimeError(f"{role} did not start")

    def result(self) -> dict[str, float]:
        """Wait for its end; return what it measured."""
        output, _nothing = self.process.communicate(timeout=600)
        if self.process.returncode:
            raise RuntimeError(f"an application failed with exit code {self.process.returncode}")
        measured: dict[str, float] = json.loads(output)
        return measured


_ROLES: dict[str, Callable[[list[str]], dict[str, float]]] = {
    "publish": lambda a: publish(a[0], a[1], int(a[2]), int(a[3])),
    "subscribe": lambda a: subscribe(a[0], int(a[1])),
    "publish_async": lambda a: asyncio.run(publish_async(a[0], a[1], int(a[2]), int(a[3]))),
    "subscribe_async": lambda a: asyncio.run(subscribe_async(a[0], int(a[1]))),
    "udp_send": lambda a: udp_send(int(a[0]), float(a[1])),
    "udp_receive": lambda a: udp_receive(float(a[0])),
    "tcp_send": lambda a: tcp_send(int(a[0]), float(a[1])),
    "tcp_receive": lambda _: tcp_receive(),
}

if __name__ == "__main__":
    print(json.dumps(_ROLES[sys.argv[1]](sys.argv[2:])))
