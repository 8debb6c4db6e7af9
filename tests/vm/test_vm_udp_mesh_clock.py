"""The wall clock jumps while real daemons run, in a kernel of their own: nothing expires early, nothing is lost."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.system.test_udp_mesh_features import hosts, stations  # noqa: F401 (fixtures are used by their names)
from tests.system.test_udp_mesh_io import Host, connect
from udp_mesh.client import Client

pytestmark = pytest.mark.lab_clock("virtual")

DAY_S = 86_400.0


@pytest.fixture
def jump() -> Iterator[Callable[[float], None]]:
    """Moves the wall clock of this box, and moves it back in the end."""
    if "User Mode Linux" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("moves the machine's clock: only in a kernel of its own (`make test-vm`)")
    offset_s = time.time() - time.monotonic()

    def _jump(by_s: float) -> None:
        time.clock_settime(time.CLOCK_REALTIME, time.time() + by_s)

    yield _jump
    time.clock_settime(time.CLOCK_REALTIME, time.monotonic() + offset_s)


def drain(client: Client, count: int) -> list[int]:
    numbers: list[int] = []
    while len(numbers) < count and (message := client.receive(timeout_s=20.0)) is not None:
        numbers.append(int(message.payload))
    return numbers


@pytest.mark.parametrize("by_s", [3600.0, -3600.0, 30 * DAY_S, -30 * DAY_S])
def test_a_clock_that_jumps_expires_and_loses_nothing(
    stations: tuple[Host, Host],  # noqa: F811
    jump: Callable[[float], None],
    by_s: float,
) -> None:
    a, b = stations
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("log")
        receiver.stats()
        assert sender.wait_for_peer("beta", 5.0)
        deliveries = []
        for number in range(40):
            if number in (10, 25):
                jump(by_s if number == 10 else -2 * by_s)
            offline = "store" if number % 2 else "discard"
            deliveries.append(
                sender.publish_tracked("log", str(number).encode(), to="beta", offline=offline, lifetime_s=60.0)
            )
            time.sleep(0.01)
        assert sorted(drain(receiver, 40)) == list(range(40))
        for delivery in deliveries:
            assert delivery.wait(5.0)
            fate = delivery.fates["beta"]
            assert fate.latency_s is not None
            assert 0 <= fate.latency_s < 1.0, "the monotonic clock counts"
        b.stop(signal.SIGKILL)  # what waits in the file survives a jump, and a restart after it
        sender.publish_wait("log", b"40", to="beta", offline="store", lifetime_s=60.0, timeout_s=5.0)
        jump(by_s)
        a.stop(signal.SIGKILL)
        a.start()
        b.start()
        assert drain(receiver, 1) == [40]
    reported = [json.loads(line) for host in (a, b) for line in host.events.read_text().splitlines()]
    assert not [event for event in reported if event["event"] in ("message_dropped", "stored_dropped")]
    assert not [event for event in reported if event["event"] == "peer_down" and event["reason"] == "beacons_missed"]
