"""What the daemon offers beyond plain messages, between two real daemons: questions, zstd, the store, its faults."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.system.test_udp_mesh_io import Host, connect, hosts  # noqa: F401 (a fixture is used by its name)
from udp_mesh import cli
from udp_mesh.client import AsyncClient, Refused, RequestFailed


@pytest.fixture
def stations(hosts: tuple[Host, Host]) -> tuple[Host, Host]:  # noqa: F811
    """The two hosts, each with a store file of its own."""
    for host in hosts:
        host.config.write_text(host.config.read_text() + f'store = "{host.config.with_suffix(".db")}"\n')
    return hosts


def test_a_question_is_answered_and_a_vain_one_ends_with_its_reason(stations: tuple[Host, Host]) -> None:
    a, b = stations
    a.start()
    b.start()
    with connect(a) as asker, connect(b) as answerer, connect(b) as listener:
        answerer.subscribe("service")
        listener.subscribe("*")
        answerer.stats()
        assert asker.wait_for_peer("beta", 3.0)
        with pytest.raises(RequestFailed, match="nobody"):
            asker.request("unknown", b"?", to="beta")
        with pytest.raises(Refused, match="unknown_peer"):
            asker.request("service", b"?", to="gamma")
        with ThreadPoolExecutor(1) as pool:
            asked = pool.submit(asker.request, "service", b"six times nine?", to="beta", priority=2)
            question = answerer.receive(timeout_s=5.0)
            assert question is not None
            assert (question.payload, question.source, question.priority) == (b"six times nine?", "alpha", 2)
            answerer.reply(question, b"42" * 5000)
            answerer.reply(question, b"too late")
            assert asked.result(timeout=5.0) == b"42" * 5000
        with pytest.raises(RequestFailed, match="no answer in time"):
            asker.request("service", b"and now?", to="beta", timeout_s=0.2)
        assert listener.receive(timeout_s=0.0) is None
    with connect(a) as asker:
        b.stop(signal.SIGKILL)
        with pytest.raises(RequestFailed, match=r"expired|no answer"):
            asker.request("service", b"?", to="beta", timeout_s=1.0)


def test_a_compressed_topic_arrives_as_it_was_and_costs_less(stations: tuple[Host, Host]) -> None:
    a, b = stations
    a.config.write_text(a.config.read_text() + "[topics.map]\ncompress = true\n")
    a.start()
    b.start()
    noise, text = os.urandom(50_000), b"tunnel " * 50_000
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("map")
        receiver.stats()
        assert sender.wait_for_peer("beta", 3.0)
        for payload, offline in ((text, "discard"), (noise, "discard"), (b"", "discard"), (text, "store")):
            sender.publish_wait("map", payload, to="beta", offline=offline, timeout_s=5.0)
            message = receiver.receive(timeout_s=5.0)
            assert message is not None
            assert message.payload == payload
    queued = [json.loads(line) for line in a.events.read_text().splitlines()]
    sizes = [e["size_bytes"] for e in queued if e["event"] == "message_queued" and e["topic"] == "map"]
    assert sizes[0] < 1000
    assert sizes[1:3] == [50_000, 0]
    assert sizes[3] < 1000


def test_stored_messages_outlive_both_daemons_and_each_arrives_once(stations: tuple[Host, Host]) -> None:
    a, b = stations
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("log")
        receiver.stats()
        assert sender.wait_for_peer("beta", 5.0)
        sender.publish_wait("log", b"0", to="beta", offline="store", timeout_s=5.0)
        b.stop(signal.SIGKILL)
        for number in range(1, 6):
            sender.publish("log", str(number).encode(), to="beta", offline="store")
        sender.publish_wait("log", b"6", to="beta", offline="store", timeout_s=5.0)
        a.stop(signal.SIGKILL)
        sender.publish("log", b"7", to="beta", offline="store")  # kept by the client until a daemon has it
        a.start()
        sender.publish_wait("log", b"8", to="beta", offline="store", timeout_s=5.0)
        b.start()
        received = []
        deadline_s = time.monotonic() + 10.0
        while len(received) < 9 and time.monotonic() < deadline_s:
            message = receiver.receive(timeout_s=0.2)
            received += [] if message is None else [int(message.payload)]
        assert sorted(received) == list(range(9))
        assert receiver.receive(timeout_s=1.0) is None


def test_a_store_that_cannot_be_is_told_and_the_rest_works(stations: tuple[Host, Host]) -> None:
    a, b = stations
    a.config.write_text(a.config.read_text().replace("alpha.db", "alpha.toml/alpha.db"))
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("t")
        receiver.stats()
        assert sender.wait_for_peer("beta", 5.0)
        with pytest.raises(Refused, match="store_failed"):
            sender.publish_wait("t", b"stored", to="beta", offline="store", timeout_s=5.0)
        sender.publish_wait("t", b"plain", to="beta", timeout_s=5.0)
        message = receiver.receive(timeout_s=5.0)
        assert message is not None
        assert message.payload == b"plain"
    events = [json.loads(line) for line in a.events.read_text().splitlines()]
    problems = [event for event in events if event["event"] == "store_problem"]
    assert [problem["reason"] for problem in problems] == ["store_failed"]
    assert "alpha.toml" in problems[0]["detail"]


def test_what_cannot_be_sent_is_refused_with_its_reason_and_nothing_else_is_lost(stations: tuple[Host, Host]) -> None:
    a, b = stations
    a.config.write_text(a.config.read_text() + "queue_bytes = 65536\nstore_bytes = 65536\n")
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("t")
        receiver.stats()
        assert sender.wait_for_peer("beta", 5.0)
        for offline in ("discard", "store"):
            with pytest.raises(Refused, match="too_large"):
                sender.publish_wait("t", bytes(70_000), to="beta", offline=offline, timeout_s=5.0)
            for to, reason in (("gamma", "unknown_peer"), ("alpha", "own_name")):
                with pytest.raises(Refused, match=reason):
                    sender.publish_wait("t", b"x", to=to, offline=offline, timeout_s=5.0)
        assert sender.refusals == {"too_large": 2, "unknown_peer": 2, "own_name": 2}
        b.stop(signal.SIGKILL)
        for number in range(20):  # twice what the store holds: the oldest go
            sender.publish_wait("t", bytes([number]) * 6000, to="beta", offline="store", timeout_s=5.0)
        with pytest.raises(Refused, match="store_full"):
            sender.publish_wait("t", bytes(60_000), to="beta", offline="store", priority=200, timeout_s=5.0)
        counters = sender.stats()["counters"]
        assert isinstance(counters, dict)
        assert counters["stored_dropped_store_full"] == 10
        b.start()
        received = [receiver.receive(timeout_s=5.0) for _ in range(10)]
        assert sorted(m.payload[0] for m in received if m is not None) == list(range(10, 20))


def test_the_asyncio_client_does_the_same(stations: tuple[Host, Host]) -> None:
    a, b = stations
    a.start()
    b.start()

    async def talk() -> list[bytes]:
        async with AsyncClient(a.socket) as asker, AsyncClient(b.socket) as answerer:
            await answerer.subscribe("service")
            await answerer.stats()
            assert await asker.wait_for_peer("beta", 5.0)
            asker.watch_status(0.05)
            status = await asker.wait_for_status(5.0)
            assert status is not None
            assert status.peers[0].name == "beta"
            asked = asyncio.create_task(asker.request("service", b"?", to="beta"))
            question = await answerer.receive(timeout_s=5.0)
            assert question is not None
            answerer.reply(question, b"!")
            with pytest.raises(RequestFailed, match="nobody"):
                await asker.request("nothing", b"?", to="beta")
            asker.publish("service", b"stored", to="beta", offline="store")
            await asker.publish_wait("service", b"waited for", to="beta", offline="store", timeout_s=5.0)
            stored = [await answerer.receive(timeout_s=5.0) for _ in range(2)]
            return [await asked, *(message.payload for message in stored if message is not None)]

    assert asyncio.run(talk()) == [b"!", b"stored", b"waited for"]


def test_the_command_line_asks_and_prints_metrics(stations: tuple[Host, Host], capsysbinary: Any) -> None:
    a, b = stations
    a.start()
    b.start()
    with connect(a) as waiter:
        assert waiter.wait_for_peer("beta", 5.0)
    assert cli.main(["--socket", a.socket, "ask", "time", "--to", "beta"]) == 1
    assert b"nobody there has subscribed" in capsysbinary.readouterr().err
    assert cli.main(["--socket", a.socket, "pub", "t", "x", "--to", "beta", "--offline", "store"]) == 0
    assert cli.main(["--socket", a.socket, "metrics"]) == 0
    text = capsysbinary.readouterr().out.decode()
    assert 'udp_mesh_peer_online{node="alpha",peer="beta"} 1\n' in text
    assert "# TYPE udp_mesh_stored_messages gauge\n" in text
