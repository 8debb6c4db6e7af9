"""What goes wrong around real daemons: each fault is told with its reason, and nothing else is lost."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.mesh_faults import bridged, events, on_small_disk, resize
from tests.system.test_udp_mesh_features import hosts, stations  # noqa: F401 (fixtures are used by their names)
from tests.system.test_udp_mesh_io import Host, connect
from udp_mesh.client import Client, Fate, Outcome, Refused, WouldBlock


def received(client: Client, count: int, within_s: float = 15.0) -> list[bytes]:
    """So many payloads, or those that came in time."""
    payloads: list[bytes] = []
    deadline_s = time.monotonic() + within_s
    while len(payloads) < count and time.monotonic() < deadline_s:
        message = client.receive(timeout_s=0.2)
        payloads += [] if message is None else [message.payload]
    return payloads


@pytest.fixture
def twins(tmp_path: Path) -> Iterator[list[Host]]:
    with bridged(tmp_path, ("alpha", "beta", "alpha", "gamma")) as four:
        yield four


def test_two_nodes_with_one_name_are_told_everywhere_and_third_nodes_talk_on(twins: list[Host]) -> None:
    alpha, beta, twin, gamma = twins
    for host in (alpha, beta, gamma):
        host.start()
    with connect(beta) as sender, connect(gamma) as receiver, connect(twin if twin.daemon else alpha) as first:
        receiver.subscribe("t")
        first.subscribe("t")
        receiver.stats()
        assert sender.wait_for_peer("gamma", 5.0)
        assert sender.wait_for_peer("alpha", 5.0)
        twin.start()
        with connect(twin) as second:
            second.subscribe("t")
            deadline_s = time.monotonic() + 10.0
            told: set[str] = set()
            sent = 0
            while len(told) < 4 and time.monotonic() < deadline_s:
                sender.publish_wait("t", str(sent).encode(), to="gamma", timeout_s=5.0)
                sent += 1
                time.sleep(0.05)
                told = {str(host.socket) for host in twins if events(host, "name_conflict")}
            assert len(told) == 4, "both holders of the name, and both that talk to it"
        assert received(receiver, sent) == [str(number).encode() for number in range(sent)]
    for host in (beta, gamma):
        assert {event["peer"] for event in events(host, "name_conflict")} == {"alpha"}
        assert not [event for event in events(host, "peer_down") if event["peer"] != "alpha"]
    with connect(beta) as client:
        counters = client.stats()["counters"]
        assert isinstance(counters, dict)
        assert counters["name_conflicts"] > 0


def test_a_full_disk_at_the_sender_refuses_and_keeps_what_it_has(
    hosts: tuple[Host, Host],  # noqa: F811
    tmp_path: Path,
) -> None:
    a, b = hosts
    on_small_disk(a, tmp_path / "disk", "600k")
    b.config.write_text(b.config.read_text() + f'store = "{tmp_path}/beta.db"\n')
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("log")
        receiver.stats()
        assert sender.wait_for_peer("beta", 5.0)
        b.stop(signal.SIGKILL)
        taken = 0
        with contextlib.suppress(Refused):
            while taken < 100:
                sender.publish_wait("log", bytes([taken]) * 10_000, to="beta", offline="store", timeout_s=5.0)
                taken += 1
        assert 3 < taken < 60
        assert sender.refusals == {"disk_full": 1}
        vain = sender.publish_tracked("log", bytes(10_000), to="beta", offline="store")
        assert vain.wait(5.0)
        assert (vain.fates["beta"].outcome, vain.fates["beta"].reason) == (Outcome.FAILED, "disk_full")
        b.start()
        assert sorted(payload[0] for payload in received(receiver, taken)) == list(range(taken))
        sender.publish_wait("log", b"plain", to="beta", timeout_s=5.0)
        assert received(receiver, 1) == [b"plain"]
        resize(a, tmp_path / "disk", "1m")  # as if somebody had tidied up
        last = sender.publish_tracked("log", b"last", to="beta", offline="store")
        assert last.wait(5.0)
        assert last.is_acknowledged
        assert received(receiver, 1) == [b"last"]
        assert a.stop() == 0
    a.prefix = []
    assert {event["reason"] for event in events(a, "store_problem")} == {"disk_full"}


def test_a_full_disk_at_the_receiver_leaves_messages_with_their_sender(
    hosts: tuple[Host, Host],  # noqa: F811
    tmp_path: Path,
) -> None:
    a, b = hosts
    a.config.write_text(a.config.read_text() + f'store = "{tmp_path}/alpha.db"\n')
    on_small_disk(b, tmp_path / "disk", "400k")
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        assert sender.wait_for_peer("beta", 5.0)
        receiver.subscribe("plain")
        receiver.stats()
        deliveries = [
            sender.publish_tracked("log", bytes([number]) * 20_000, to="beta", offline="store") for number in range(30)
        ]
        deadline_s = time.monotonic() + 10.0
        while not events(b, "store_problem") and time.monotonic() < deadline_s:
            sender.publish_wait("plain", b"x", to="beta", timeout_s=5.0)
            assert received(receiver, 1) == [b"x"]
        assert {event["reason"] for event in events(b, "store_problem")} == {"disk_full"}
        assert not all(delivery.wait(0.0) for delivery in deliveries)
        resize(b, tmp_path / "disk", "8m")
        receiver.subscribe("log")
        assert sorted(payload[0] for payload in received(receiver, 30, 30.0)) == list(range(30))
        assert all(delivery.wait(5.0) for delivery in deliveries)
        assert all(delivery.is_acknowledged for delivery in deliveries)


def test_a_full_queue_drops_or_refuses_and_says_so(stations: tuple[Host, Host]) -> None:  # noqa: F811
    a, b = stations
    slow = "".join(f"[topics.{topic}]\nrate_limit_hz = 0.001\n" for topic in ("map", "plan"))
    a.config.write_text(a.config.read_text() + "queue_bytes = 100000\n" + slow)
    a.start()
    b.start()
    with connect(a) as sender, connect(a) as patient, connect(b) as receiver:
        receiver.subscribe("*")
        receiver.stats()
        assert sender.wait_for_peer("beta", 5.0)
        for topic in ("map", "plan"):  # the first passes, the following ones wait
            sender.publish_wait(topic, b"first", to="beta", timeout_s=5.0)
            assert received(receiver, 1) == [b"first"]
        old = [sender.publish_tracked("map", bytes(20_000), to="beta") for _ in range(5)]
        while not all(delivery.peers for delivery in old):
            sender.stats()
        with pytest.raises(WouldBlock):  # who waits for room drops nothing
            patient.publish_wait("map", bytes(20_000), to="beta", timeout_s=0.2)
        assert not any(delivery.wait(0.0) for delivery in old)
        urgent = sender.publish_tracked("plan", bytes(90_000), to="beta", priority=1)
        assert all(delivery.wait(5.0) for delivery in old)
        assert {delivery.fates["beta"] for delivery in old} == {Fate("beta", Outcome.FAILED, "queue_full")}
        vain = sender.publish_tracked("map", bytes(20_000), to="beta", priority=9)
        assert vain.wait(5.0)
        assert vain.fates == {"beta": Fate("beta", Outcome.FAILED, "queue_full")}
        assert not urgent.wait(0.0)
        sender.publish_wait("other", b"small", to="beta", timeout_s=5.0)
        assert received(receiver, 1) == [b"small"]
    reasons = [event["reason"] for event in events(a, "message_dropped")]
    assert reasons == ["queue_full"] * 5


@pytest.mark.parametrize("stored", [3, 400])
def test_a_store_file_that_is_damaged_while_in_use_is_told_and_replaced(
    stations: tuple[Host, Host],  # noqa: F811
    stored: int,
) -> None:
    a, b = stations
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("log")
        receiver.stats()
        assert sender.wait_for_peer("beta", 5.0)
        b.stop(signal.SIGKILL)
        sender.publish("log", b"who misses it?", to="beta")
        deadline_s = time.monotonic() + 10.0
        while sender.peers()[0].online and time.monotonic() < deadline_s:
            time.sleep(0.02)  # from then on only the file has what is stored
        early = [
            sender.publish_tracked("log", number.to_bytes(2, "big") * 10_000, to="beta", offline="store")
            for number in range(stored)
        ]
        sender.publish_wait("log", b"\xff\xfe", to="beta", offline="store", timeout_s=10.0)
        for file in (a.config.with_suffix(".db"), Path(f"{a.config.with_suffix('.db')}-wal")):
            size = file.stat().st_size
            with file.open("r+b") as damaged:
                damaged.seek(size // 3)
                damaged.write(b"\xa5" * (size // 3))
        b.start()
        assert sender.wait_for_peer("beta", 10.0)
        late = [
            sender.publish_tracked("log", number.to_bytes(2, "big"), to="beta", offline="store")
            for number in range(1000, 1020)
        ]
        plain = [sender.publish_tracked("log", bytes([7, 7, number]), to="beta") for number in range(3)]
        for delivery in (*late, *early):
            assert delivery.wait(20.0)
        assert [delivery.is_acknowledged for delivery in late] == [True] * 20
        assert all(delivery.wait(5.0) and delivery.is_acknowledged for delivery in plain)
        kept = [number for number, delivery in enumerate(early) if delivery.is_acknowledged]
        lost = [delivery.fates["beta"] for delivery in early if not delivery.is_acknowledged]
        payloads = received(receiver, 10_000, 2.0)
    numbers = {int.from_bytes(payload[:2], "big") for payload in payloads if len(payload) == 20_000}
    assert {number.to_bytes(2, "big") * 10_000 for number in numbers} >= {p for p in payloads if len(p) == 20_000}
    assert numbers >= set(kept)
    assert {(fate.outcome, fate.reason) for fate in lost} <= {(Outcome.FAILED, "store_corrupted")}
    print(f"{len(kept)} kept, {len(lost)} lost", events(a, "store_problem"))
    if lost:
        assert "store_corrupted" in {event["reason"] for event in events(a, "store_problem")}
