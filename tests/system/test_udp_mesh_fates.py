"""What became of a message, as applications of two real daemons are told."""

from __future__ import annotations

import asyncio
import signal
from typing import Any

from tests.system.test_udp_mesh_features import hosts, stations  # noqa: F401 (fixtures are used by their names)
from tests.system.test_udp_mesh_io import Host, connect
from udp_mesh import cli
from udp_mesh.client import AsyncClient, Fate, Outcome


def test_a_program_learns_what_became_of_each_message(stations: tuple[Host, Host]) -> None:  # noqa: F811
    a, b = stations
    a.start()
    b.start()
    with connect(a) as sender, connect(b) as receiver:
        receiver.subscribe("t")
        receiver.stats()
        assert sender.wait_for_peer("beta", 5.0)
        for to, offline in (("beta", "discard"), ("all", "discard"), ("beta", "store"), ("all", "store")):
            delivery = sender.publish_tracked("t", bytes(3000), to=to, offline=offline)
            assert delivery.wait(timeout_s=5.0)
            (fate,) = delivery.fates.values()
            assert (fate.peer, fate.outcome, fate.reason) == ("beta", Outcome.ACKNOWLEDGED, "")
            assert fate.latency_s is not None
            assert 0 < fate.latency_s < 5
            assert delivery.is_acknowledged
            assert receiver.receive(timeout_s=5.0) is not None
        b.stop(signal.SIGKILL)
        vain = sender.publish_tracked("t", b"too late", to="beta", lifetime_s=0.3, offline="latest")
        stored = sender.publish_tracked("t", b"stored", to="beta", offline="store")
        assert vain.wait(timeout_s=5.0)
        assert (vain.fates["beta"].outcome, vain.fates["beta"].reason) == (Outcome.FAILED, "expired")
        assert not stored.wait(timeout_s=0.3)
        assert stored.peers == ("beta",)
        plain = sender.publish_tracked("t", b"plain", to="beta", offline="latest")
        a.stop(signal.SIGKILL)
        assert plain.wait(timeout_s=5.0)
        lost = Fate("beta", Outcome.UNKNOWN, "daemon_unreachable", may_have_arrived=True)
        assert plain.fates == {"beta": lost}
        a.start()
        b.start()
        assert stored.wait(timeout_s=15.0)
        assert stored.is_acknowledged


def test_an_asyncio_program_awaits_it(stations: tuple[Host, Host]) -> None:  # noqa: F811
    a, b = stations
    a.start()
    b.start()

    async def talk() -> list[dict[str, Fate]]:
        async with AsyncClient(a.socket) as sender:
            assert await sender.wait_for_peer("beta", 5.0)
            deliveries = [sender.publish_tracked("t", bytes(10), to="beta") for _ in range(50)]
            b.stop(signal.SIGKILL)
            last = sender.publish_tracked("t", b"x", to="beta", offline="latest")
            assert not await last.wait(0.0)
            a.stop(signal.SIGKILL)
            return [await delivery for delivery in (*deliveries, last)]

    fates = [fate for known in asyncio.run(talk()) for fate in known.values()]
    assert len(fates) == 51
    assert fates[-1].reason == "daemon_unreachable"


def test_the_command_line_prints_it(stations: tuple[Host, Host], capsys: Any) -> None:  # noqa: F811
    a, b = stations
    a.start()
    b.start()
    with connect(a) as waiter:
        assert waiter.wait_for_peer("beta", 5.0)
        assert cli.main(["--socket", a.socket, "pub", "t", "x", "--to", "beta", "--wait"]) == 0
        assert capsys.readouterr().out.startswith("beta acknowledged after ")
        b.stop(signal.SIGKILL)
        waiter.publish("t", b"is anybody there?", to="beta")
        words = ["pub", "t", "x", "--offline", "latest", "--wait", "--to"]
        assert cli.main(["--socket", a.socket, *words, "beta", "--lifetime", "0.8"]) == 1
        out = capsys.readouterr().out
        assert out.startswith("beta failed: expired"), out
        assert cli.main(["--socket", a.socket, "--timeout", "0.5", *words, "beta"]) == 1
        assert capsys.readouterr().out == "beta no word within 0.5 s\n"
        assert cli.main(["--socket", a.socket, *words, "gamma"]) == 1
        assert capsys.readouterr().err == "udp-mesh: unknown_peer\n"
