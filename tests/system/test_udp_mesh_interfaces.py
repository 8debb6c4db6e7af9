"""Interfaces that change under the real daemon: another address, away and back. What was promised holds."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.system.udp_mesh_hosts import Host, join, separate_hosts
from udp_mesh.client import Client


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[Host, Host]]:
    """Two hosts on one wire, with daemons that know each other."""
    with separate_hosts(tmp_path, "alpha", "beta") as (a, b):
        join(a, b, "mesh0", network="10.9.0")
        for host in (a, b):
            host.start("")
        yield a, b


def test_a_session_goes_on_when_an_interface_gets_another_address(pair: tuple[Host, Host]) -> None:
    a, b = pair

    def renumber() -> None:
        a.ip("address", "delete", "10.9.0.1/24", "dev", "mesh0")
        a.ip("address", "add", "10.9.0.77/24", "broadcast", "10.9.0.255", "dev", "mesh0")

    epoch = deliver_all(a, b, renumber)
    with Client(b.socket) as client:
        (peer,) = client.peers()
    assert peer.address == "10.9.0.77"
    assert [event["epoch"] for event in b.happened("peer_up") if event["peer"] == "alpha"][-1] == epoch


def test_messages_wait_for_an_interface_that_goes_and_comes_back(pair: tuple[Host, Host]) -> None:
    a, b = pair

    def away_and_back() -> None:
        a.ip("link", "set", "mesh0", "down")
        a.ip("address", "flush", "dev", "mesh0")
        time.sleep(2.5)  # longer than the daemon takes to see it, and to hold the other one offline
        a.ip("address", "add", "10.9.0.1/24", "broadcast", "10.9.0.255", "dev", "mesh0")
        a.ip("link", "set", "mesh0", "up")

    deliver_all(a, b, away_and_back)
    assert a.happened("peer_down")


def deliver_all(a: Host, b: Host, change: Callable[[], None]) -> int:
    """Send messages before, during and after a change; all of them arrive once. Return the sender's epoch."""
    with Client(a.socket) as sender, Client(b.socket) as receiver:
        receiver.subscribe("*")
        receiver.stats()
        assert sender.wait_for_peer("beta", 10.0)
        for number in range(40):
            if number == 20:
                change()
            sender.publish(f"t{number}", bytes(20_000), to="beta", offline="latest")  # the newest of each topic waits
        got = []
        while len(got) < 40 and (message := receiver.receive(timeout_s=15.0)) is not None:
            got.append(message.topic)
        epoch = sender.stats()["epoch"]
    assert sorted(got) == sorted(f"t{number}" for number in range(40))
    assert isinstance(epoch, int)
    return epoch
