"""The real daemon over IPv6, two interfaces, raw Ethernet, a serial line, and with a key. Leaves nothing behind."""

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
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from udp_mesh.client import Client

KEY, OTHER_KEY = "00" * 31 + "01", "00" * 31 + "02"
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


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[tuple[Host, Host]]:
    """Two hosts that nothing joins yet."""
    if os.geteuid() != 0:
        pytest.skip("makes network namespaces and devices of its own: run it as root, or in `netlab vm`")
    with contextlib.ExitStack() as stack:
        pair = []
        for name in ("alpha", "beta"):
            host = Host(name, tmp_path)
            stack.callback(host.close)
            pair.append(host)
        yield pair[0], pair[1]


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


def test_ipv6_alone_is_enough(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    join(a, b, "mesh0", mtu=1400)
    for host in hosts:
        host.start('[[carriers]]\nkind = "udp6"\n')
    with exchange(a, b) as sender:
        (peer,) = sender.peers()
        assert peer.address.startswith("fe80::")
        counters = sender.stats()["counters"]
        assert not [name for name in counters if name.startswith(("send_E", "bad_"))], counters


def test_raw_ethernet_needs_no_addresses(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    join(a, b, "mesh0", mtu=1280)
    for host in hosts:
        host.start('interfaces = ["mesh0"]\n[[carriers]]\nkind = "ethernet"\n')
    with exchange(a, b) as sender:
        (peer,) = sender.peers()
        assert peer.address.count(":") == 5
        counters = sender.stats()["counters"]
        assert not [name for name in counters if name.startswith(("send_E", "bad_", "ethernet_"))], counters


GARBAGE = """
import os, random, socket
rng = random.Random(5)
sender = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM)
for _ in range(300):
    data = rng.randbytes(rng.randrange(0, 200))
    if rng.random() < 0.5:
        data = rng.randrange(0, 300).to_bytes(2, "big") + b"uM\\x01" + data
    sender.sendto(data, ("mesh0", 0x88B5, 0, 0, b"\\xff" * 6))
"""


def test_garbage_on_the_ethernet_is_counted_and_harms_nobody(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    join(a, b, "mesh0")
    for host in hosts:
        host.start('interfaces = ["mesh0"]\n[[carriers]]\nkind = "ethernet"\n')
    subprocess.run([*b.enter, sys.executable, "-c", GARBAGE], check=True)
    with exchange(a, b) as sender:
        counters = sender.stats()["counters"]
        refused = sum(count for name, count in counters.items() if name.startswith(("bad_", "ethernet_bad")))
        assert refused >= 200, counters  # some are what they seem: a datagram of a stranger, too long a padding


def test_a_second_interface_takes_over_after_a_silent_cut(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    join(a, b, "mesh0", network="10.9.0")
    join(a, b, "mesh1", network="10.9.1")
    for host in hosts:
        host.start("")
    with exchange(a, b) as sender, Client(b.socket) as receiver:
        receiver.subscribe("t")
        receiver.stats()
        (peer,) = sender.peers()
        used = "mesh0" if peer.address.startswith("10.9.0.") else "mesh1"
        for host in hosts:  # the interfaces stay up and have their addresses; nothing arrives
            limits = ["tbf", "rate", "8bit", "burst", "10", "limit", "1"]
            subprocess.run([*host.enter, "tc", "qdisc", "add", "dev", used, "root", *limits], check=True)
        cut_at_s = time.monotonic()
        sender.publish("t", b"by the other one", to="beta")
        message = receiver.receive(timeout_s=5.0)
        assert message is not None
        assert message.payload == b"by the other one"
        assert time.monotonic() - cut_at_s < 1.0  # a probe timeout and a busy machine; exact figures in virtual time
    assert a.happened("path_changed")
    assert not a.happened("peer_down")


def test_keys_decide_who_meets(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    join(a, b, "mesh0", network="10.9.0")
    a.start(f'key = "{KEY}"\n')
    b.start(f'key = ["{OTHER_KEY}", "{KEY}"]\n')
    with Client(a.socket) as client:
        assert not client.wait_for_peer("beta", 1.5)  # beta understands alpha, but not the other way round
        client.config_set("key", f'["{KEY}", "{OTHER_KEY}"]')
        config = client.stats()["config"]
        assert KEY not in json.dumps(config)
        assert len(config["key"]) == 2
    exchange(a, b).close()


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


@pytest.fixture
def line() -> Iterator[tuple[str, str]]:
    """Two device names, the ends of one line of 5 kbit/s."""
    pairs = [os.openpty() for _ in range(2)]
    for pair in pairs:
        tty.setraw(pair[1])
    wire = Line(pairs[0][0], pairs[1][0], rate_bps=5000)
    wire.start()
    yield os.ttyname(pairs[0][1]), os.ttyname(pairs[1][1])
    wire.end()
    for pair in pairs:
        for descriptor in pair:
            os.close(descriptor)


@pytest.mark.parametrize("key", ["", f'key = "{KEY}"\n'], ids=["plain", "sealed"])
def test_a_serial_line_of_5_kbit_per_second_and_255_bytes(
    hosts: tuple[Host, Host], line: tuple[str, str], key: str
) -> None:
    for host, device in zip(hosts, line, strict=True):
        host.start(f'{key}[[carriers]]\nkind = "serial"\ndevice = "{device}"\nmtu_bytes = 255\nrate_bps = 5000\n')
    with exchange(*hosts, sizes=(0, 100, 900)) as sender:
        counters = sender.stats()["counters"]
        counters.pop("bad_unproven_epoch", None)  # before the first exchange
        assert not [name for name in counters if name.startswith(("send_E", "bad_", "serial_"))], counters
