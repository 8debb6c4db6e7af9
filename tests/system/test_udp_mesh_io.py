"""The real daemon: two of them in two network namespaces, joined by a veth. Leaves nothing behind."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from udp_mesh.client import AsyncClient, Client, Refused


@contextlib.contextmanager
def _privileges() -> Iterator[list[str]]:
    """The words before a command that makes network namespaces: none as root, else what enters a user namespace."""
    if os.geteuid() == 0:
        yield []
        return
    holder = subprocess.Popen(
        ["unshare", "--user", "--map-root-user", "sh", "-c", "echo up; exec cat"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"up\n"
        yield ["nsenter", f"--user=/proc/{holder.pid}/ns/user", "--preserve-credentials"]


class Host:
    """A network namespace, held by a process, in which daemons run."""

    def __init__(self, name: str, folder: Path, privileges: list[str], extra_config: str = "") -> None:
        self.privileges = privileges
        self.name = name
        self.socket = str(folder / f"{name}.sock")
        self.events = folder / f"{name}.events"
        self.config = folder / f"{name}.toml"
        self.config.write_text(f'name = "{name}"\nsocket = "{self.socket}"\n{extra_config}')
        self.holder = subprocess.Popen(
            [*privileges, "unshare", "--net", "--kill-child", "sh", "-c", "ip link set lo up; echo $$; exec cat"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self.holder.stdout is not None
        self.pid = int(self.holder.stdout.readline())  # of the shell; unshare stays beside it
        self.daemon: subprocess.Popen[bytes] | None = None
        self.prefix: list[str] = []  # words before the daemon's command

    def ip(self, *words: str) -> None:
        """Run ip(8) in the namespace."""
        subprocess.run([*self.privileges, "nsenter", f"--net=/proc/{self.pid}/ns/net", "ip", *words], check=True)

    def start(self) -> float:
        """Start the daemon and wait until it is ready; return how long that took, in seconds."""
        began_s = time.monotonic()
        ready_read, ready_write = os.pipe()
        with self.events.open("ab") as events:
            self.daemon = subprocess.Popen(
                [
                    *(
                        *self.privileges,
                        "nsenter",
                        f"--net=/proc/{self.pid}/ns/net",
                        *self.prefix,
                        sys.executable,
                        "-m",
                        "udp_mesh",
                        "daemon",
                    ),
                    *(
                        "--config",
                        str(self.config),
                        "--ready-fd",
                        str(ready_write),
                        "--events-fd",
                        str(events.fileno()),
                    ),
                ],
                pass_fds=[ready_write, events.fileno()],
            )
        os.close(ready_write)
        with os.fdopen(ready_read, "rb") as ready:
            assert ready.read() == b"READY=1\n"
        return time.monotonic() - began_s

    def stop(self, number: int = signal.SIGTERM) -> int:
        """End the daemon; return its exit code."""
        assert self.daemon is not None
        self.daemon.send_signal(number)
        code = self.daemon.wait(timeout=5)
        self.daemon = None
        return code

    def close(self) -> None:
        """End everything."""
        if self.daemon is not None:
            self.stop(signal.SIGKILL)
        assert self.holder.stdin is not None
        assert self.holder.stdout is not None
        self.holder.stdin.close()
        self.holder.stdout.close()
        self.holder.wait(timeout=5)


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[tuple[Host, Host]]:
    with contextlib.ExitStack() as stack:
        pair = []
        privileges = stack.enter_context(_privileges())
        for name in ("alpha", "beta"):
            host = Host(name, tmp_path, privileges)
            stack.callback(host.close)
            pair.append(host)
        a, b = pair
        a.ip("link", "add", "mesh0", "type", "veth", "peer", "name", "mesh0", "netns", str(b.pid))
        for number, host in enumerate(pair, start=1):
            host.ip("address", "add", f"10.9.0.{number}/24", "broadcast", "10.9.0.255", "dev", "mesh0")
            host.ip("link", "set", "mesh0", "up")
        yield a, b


def connect(host: Host) -> Client:
    return Client(host.socket)


def test_daemons_discover_each_other_and_carry_messages_of_every_size(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("map")
        receiver.stats()  # the subscription is in force once a later question is answered
        assert sender.wait_for_peer("beta", 3.0)
        for size in (0, 1, 1399, 5000, 1_000_000):
            payload = os.urandom(size)
            sender.publish_wait("map", payload, to="beta", priority=3)
            message = receiver.receive(timeout_s=5.0)
            assert message is not None
            assert (message.payload, message.source, message.priority) == (payload, "alpha", 3)
        sender.publish("map", b"to everybody", to="all")
        message = receiver.receive(timeout_s=5.0)
        assert message is not None
        assert message.payload == b"to everybody"
        assert receiver.missed == 0
        with pytest.raises(Refused, match="unknown_peer"):
            sender.publish("map", b"x", to="gamma")
    assert a.stop() == 0
    names = [json.loads(line)["event"] for line in a.events.read_text().splitlines()]
    assert names.count("message_acked") == 5
    assert "peer_up" in names


def test_a_client_survives_the_restart_of_its_daemon(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("t")
        assert b.stop(signal.SIGKILL) == -signal.SIGKILL
        b.start()
        assert receiver.wait_for_peer("alpha", 5.0)  # it has reconnected, and subscribed again
        receiver.stats()
        assert sender.wait_for_peer("beta", 5.0)
        sender.publish_wait("t", b"after", to="beta", timeout_s=5.0)
        message = receiver.receive(timeout_s=5.0)
        assert message is not None
        assert message.payload == b"after"


def test_async_client_and_settings_at_run_time(hosts: tuple[Host, Host]) -> None:
    import asyncio

    a, b = hosts
    a.start()
    b.start()

    async def talk() -> bytes:
        async with AsyncClient(a.socket) as sender, AsyncClient(b.socket) as receiver:
            await receiver.subscribe("*")
            await receiver.stats()
            assert await sender.wait_for_peer("beta", 3.0)
            assert (await sender.config_set("window", "3"))["window"] == 3
            await sender.publish_wait("any", b"y" * 20_000, to="beta", timeout_s=5.0)
            message = await receiver.receive(timeout_s=5.0)
            assert message is not None
            return message.payload

    assert asyncio.run(talk()) == b"y" * 20_000


def test_an_interface_that_vanishes_and_returns_is_used_again(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    a.start()
    b.start()
    with connect(a) as client:
        assert client.wait_for_peer("beta", 3.0)
        a.ip("link", "delete", "mesh0")
        a.ip("link", "add", "mesh0", "type", "veth", "peer", "name", "mesh0", "netns", str(b.pid))
        for number, host in enumerate((a, b), start=1):
            host.ip("address", "add", f"10.9.0.{number}/24", "broadcast", "10.9.0.255", "dev", "mesh0")
            host.ip("link", "set", "mesh0", "up")
        with connect(b) as receiver:
            receiver.subscribe("t")
            receiver.stats()
            deadline_s = time.monotonic() + 8.0
            message = None
            while message is None and time.monotonic() < deadline_s:
                with contextlib.suppress(Refused):
                    client.publish("t", b"back", to="beta")
                message = receiver.receive(timeout_s=0.1)
    assert message is not None


def test_a_port_in_use_is_one_clear_line(hosts: tuple[Host, Host], tmp_path: Path) -> None:
    a, _b = hosts
    a.start()
    other = tmp_path / "other.toml"
    other.write_text(f'name = "other"\nsocket = "{tmp_path}/other.sock"\n')
    second = subprocess.run(
        [
            *a.privileges,
            "nsenter",
            f"--net=/proc/{a.pid}/ns/net",
            sys.executable,
            "-m",
            "udp_mesh",
            "daemon",
            "--config",
            str(other),
        ],
        capture_output=True,
        text=True,
        timeout=10,
    )
    assert second.returncode == 2
    assert second.stderr == "udp-mesh: UDP port 8700 is in use; end the other daemon or choose another port\n"
    assert not (tmp_path / "other.sock").exists()


def test_applications_follow_links_and_queues(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    a.start()
    b.start()
    with connect(a) as client:
        assert client.wait_for_peer("beta", 3.0)
        client.watch_status(0.05)
        first = client.wait_for_status(5.0)
        assert first is not None
        assert [(peer.name, peer.online) for peer in first.peers] == [("beta", True)]
        a.ip("link", "set", "mesh0", "down")
        client.publish("photo", bytes(50_000), to="beta")
        assert client.wait_for_status(5.0) is not None
        deadline_s = time.monotonic() + 5.0
        while time.monotonic() < deadline_s:
            status = client.wait_for_status(5.0)
            assert status is not None
            if status.queued == {"photo": 1} and not status.peers[0].online:
                break
        else:
            pytest.fail(f"the queue did not show: {client.status}")
        client.watch_status(0)
        client.stats()
        assert client.wait_for_status(0.3) is None
