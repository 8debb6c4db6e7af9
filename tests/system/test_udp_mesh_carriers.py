"""The real daemon over IPv6, two interfaces, raw Ethernet, a serial line, and with a key. Leaves nothing behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.udp_mesh_hosts import Host, Line, exchange, join, separate_hosts
from udp_mesh.client import Client

KEY, OTHER_KEY = "00" * 31 + "01", "00" * 31 + "02"


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[tuple[Host, Host]]:
    """Two hosts that nothing joins yet."""
    with separate_hosts(tmp_path, "alpha", "beta") as (a, b):
        yield a, b


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
        sender.stats()  # whoever answers has written its events before
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
