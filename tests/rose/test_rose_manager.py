"""A host's services from a file: started, configured, supervised, changed over the network, gone with the manager."""

from __future__ import annotations

import asyncio
import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

import rose
from rose.config.model import load_host, load_team
from rose.configuration_manager import ConfigurationManager
from rose.core.messages import AskHost, ConfigureHost, HostState
from rose.examples.messages import LaserScan, MapState
from rose.manager import ServiceManager

WAIT_S = 40.0
KEY = "ab" * 32
_hosts = itertools.count(1)


def host() -> str:
    return f"127.78.{os.getpid() % 250}.{next(_hosts)}"


def run(work: Callable[[], Awaitable[None]]) -> None:
    async def within() -> None:
        async with asyncio.timeout(120):
            await work()

    asyncio.run(within())


def host_file(tmp_path: Path, address: str, services: str, *, more: str = "") -> Path:
    path = tmp_path / f"{address}.yaml"
    path.write_text(f'host: {address}\nkeys: ["{KEY}"]\n{more}services:\n{services}')
    return path


LASER = '  - {name: laser, id: 0.1, run: "rose.examples.laser:Laser", settings: {rate_hz: 50, beams: 90}}\n'
KEYS = rose.KeyRing(team=[bytes.fromhex(KEY)])


async def state_of(manager: ServiceManager, is_so: Callable[[HostState], bool]) -> HostState:
    while not is_so(manager.state()):
        await asyncio.sleep(0.01)
    return manager.state()


def test_a_host_comes_up_whole_from_its_file(tmp_path: Path) -> None:
    async def work() -> None:
        address = host()
        mapping = (
            f'  - {{name: map, id: 0.2, run: "rose.examples.mapping:Mapping", settings: {{laser: {address}/0.1}}}}\n'
        )
        manager = ServiceManager(load_host(host_file(tmp_path, address, LASER + mapping)))
        await manager.start()
        try:
            assert [service.state for service in manager.state().services] == ["running", "running"]
            async with rose.Service(f"{address}/31.1", keys=KEYS) as reader:
                scans, maps = (
                    reader.subscribe(f"{address}/0.1", LaserScan),
                    reader.subscribe(f"{address}/0.2", MapState),
                )
                scan, drawn = await scans.receive(WAIT_S), await maps.receive(WAIT_S)
                assert scan is not None
                assert drawn is not None
                assert isinstance(scan.message, LaserScan)
                assert len(scan.message.ranges_m) == 90  # the settings of the file
                assert isinstance(drawn.message, MapState)
                assert drawn.message.occupied_cells > 10
        finally:
            await manager.close()

    run(work)


def test_what_cannot_run_is_told_and_does_not_hold_up_the_rest(tmp_path: Path) -> None:
    services = LASER + (
        '  - {name: nothing, id: 0.2, run: "rose.examples.laser:Nothing", restart: never}\n'
        '  - {name: typo, id: 0.3, run: "rose.examples.laser:Laser", settings: {rate: 5}}\n'
        "  - {name: missing, id: 0.4, argv: [/no/such/program], restart: never}\n"
        f"  - {{name: fails, id: 0.5, argv: [{sys.executable}, -c, 'print(\"no laser\"); exit(3)'], restart: never}}\n"
    )

    async def work() -> None:
        manager = ServiceManager(load_host(host_file(tmp_path, host(), services)))
        await manager.start()
        try:
            state = await state_of(manager, lambda s: all(service.state != "starting" for service in s.services))
            told = {service.name: (service.state, service.detail) for service in state.services}
            assert told["laser"] == ("running", "")
            assert told["nothing"][0] == "failed"
            assert "there is no class Nothing in rose.examples.laser" in told["nothing"][1]
            assert told["typo"][0] == "failed"
            assert "Object contains unknown field `rate`" in told["typo"][1]
            assert told["missing"] == ("failed", "/no/such/program: No such file or directory")
            assert told["fails"] == ("failed", "no laser")
        finally:
            await manager.close()

    run(work)


def test_a_service_that_dies_is_started_again(tmp_path: Path) -> None:
    async def work() -> None:
        address = host()
        manager = ServiceManager(load_host(host_file(tmp_path, address, LASER)))
        await manager.start()
        try:
            (supervised,) = manager._supervised.values()
            assert supervised._process is not None
            supervised._process.send_signal(signal.SIGKILL)
            state = await state_of(manager, lambda s: s.services[0].restarts == 1 and s.services[0].state == "running")
            assert state.services[0].detail == ""
            async with rose.Service(f"{address}/31.1", keys=KEYS) as reader:
                assert await reader.subscribe(f"{address}/0.1", LaserScan).receive(WAIT_S) is not None
        finally:
            await manager.close()

    run(work)


def test_a_configuration_manager_configures_many_hosts_and_they_keep_it(tmp_path: Path) -> None:
    async def work() -> None:
        addresses = [host(), host()]
        files = [host_file(tmp_path, a, "  []\n", more="accept_configuration: true\n") for a in addresses]
        hosts = "".join(f"  {a}:\n    services:\n    {LASER}" for a in addresses)
        team_file = tmp_path / "team.yaml"
        team_file.write_text(f'host: {host()}\nkeys: ["{KEY}"]\nhosts:\n{hosts}')
        managers = [ServiceManager(load_host(f), kept=f.with_suffix(".kept.json")) for f in files]
        said: list[str] = []
        configuring = ConfigurationManager(load_team(team_file), said.append)
        await asyncio.gather(*(manager.start() for manager in managers))
        try:
            await configuring.start()
            assert await configuring.wait(WAIT_S) == set()
            for manager in managers:
                await state_of(manager, lambda s: [service.state for service in s.services] == ["running"])
        finally:
            await configuring.close()
            await asyncio.gather(*(manager.close() for manager in managers))
        assert len(said) == 2
        # The next start needs nobody.
        alone = ServiceManager(load_host(files[0]), kept=files[0].with_suffix(".kept.json"))
        await alone.start()
        try:
            assert [(service.name, service.state) for service in alone.state().services] == [("laser", "running")]
        finally:
            await alone.close()

    run(work)


def test_nobody_without_the_key_starts_programs_here(tmp_path: Path) -> None:
    async def work() -> None:
        address = host()
        file = host_file(tmp_path, address, LASER, more="accept_configuration: true\n")
        manager = ServiceManager(load_host(file), kept=file.with_suffix(".kept.json"))
        await manager.start()
        try:
            order = ConfigureHost("x", [{"name": "evil", "robot": 0, "service": 9, "argv": ["touch", "/x"]}])
            async with rose.Service(f"{address}/31.1") as stranger:
                with pytest.raises(rose.CallError, match="did not answer"):
                    await stranger.call(f"{address}/0.0", order, rose.Done, timeout_s=0.3)
            wrong = [{"name": "bad", "robot": 99, "service": 1, "argv": ["x"]}]
            async with rose.Service(f"{address}/31.1", keys=KEYS) as friend:
                with pytest.raises(rose.CallError, match="robot 99 is impossible"):
                    await friend.call(f"{address}/0.0", ConfigureHost("x", wrong), rose.Done, timeout_s=WAIT_S)
                state = await friend.call(f"{address}/0.0", AskHost(), HostState, timeout_s=WAIT_S)
                assert [service.name for service in state.services] == ["laser"]
        finally:
            await manager.close()

    run(work)


def test_a_host_whose_file_does_not_say_so_takes_no_orders(tmp_path: Path) -> None:
    async def work() -> None:
        address = host()
        manager = ServiceManager(load_host(host_file(tmp_path, address, LASER)))
        await manager.start()
        try:
            async with rose.Service(f"{address}/31.1", keys=KEYS) as friend:
                with pytest.raises(rose.CallError, match="takes no configuration over the network; set accept"):
                    await friend.call(f"{address}/0.0", ConfigureHost("x", []), rose.Done, timeout_s=WAIT_S)
        finally:
            await manager.close()

    run(work)


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGKILL])
def test_the_services_go_with_their_manager(tmp_path: Path, signum: signal.Signals) -> None:
    address = host()
    read_fd, write_fd = os.pipe()
    alive_fd, service_fd = os.pipe()  # inherited by every service: end of file once the last one is gone
    argv = [sys.executable, "-m", "rose", "run", str(host_file(tmp_path, address, LASER)), "--ready-fd", str(write_fd)]
    process = subprocess.Popen(argv, pass_fds=(write_fd, service_fd), stderr=subprocess.PIPE)
    os.close(write_fd)
    os.close(service_fd)
    try:
        assert os.read(read_fd, 16) == b"ready\n"
        pids = _children(process.pid)
        assert pids
        process.send_signal(signum)
        assert process.wait(30) == (0 if signum is signal.SIGTERM else -signal.SIGKILL)
        for pid in pids:
            _wait_gone(pid)
    finally:
        process.kill()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()
        os.close(read_fd)
        os.close(alive_fd)


def _children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _wait_gone(pid: int) -> None:
    try:
        fd = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        import select

        assert select.select([fd], [], [], 30.0)[0], f"service process {pid} outlives its manager"
    finally:
        os.close(fd)
