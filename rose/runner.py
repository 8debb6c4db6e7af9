"""The process of one service: ``python -m rose.runner``, its start-up values as one JSON line on standard input.

It comes up without settings and takes them, then and later, as ``rose/configure`` commands: over loopback from this
host's Service Manager, or sealed over the network. With new settings the program begins anew; wrong ones are refused
and change nothing. It says "ready" on ``ready_fd`` when its sockets are open.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys

import msgspec

from rose.core.addressing import ServiceId
from rose.core.keys import KeyRing
from rose.core.messages import Configure, Done
from rose.core.types import Message
from rose.errors import CallError, RoseError
from rose.io.transport import Transport
from rose.program import Program, load_program, settings_of
from rose.service import Command, Service
from udp_mesh.io.dscp import dscp_of


class Start(msgspec.Struct, frozen=True):
    """What a service's process is told before it can be spoken to. ``keys``: hexadecimal, by service id; "" is all."""

    sid: str
    run: str
    keys: dict[str, list[str]] = {}
    transport: str = "udp"
    priority: int = 5
    offline: str = "discard"
    hops: int = 1
    fresh_s: float = 60.0
    ready_fd: int | None = None


def keys_as_text(keys: KeyRing) -> dict[str, list[str]]:
    """Return keys for :class:`Start`."""
    named = {str(sid): [key.hex() for key in own] for sid, own in keys.by_service.items()}
    return named | ({"": [key.hex() for key in keys.team]} if keys.team else {})


def _keys(texts: dict[str, list[str]]) -> KeyRing:
    by_service = {ServiceId.parse(sid): [bytes.fromhex(key) for key in own] for sid, own in texts.items() if sid}
    return KeyRing(by_service, [bytes.fromhex(key) for key in texts.get("", [])])


def make_transport(kind: str, *, priority: int, offline: str, hops: int) -> Transport:
    """Return what carries a service's datagrams.

    Raises:
        RoseError: The kind needs something that is not installed.
    """
    if kind == "udp_mesh":
        from rose.io.mesh import MeshTransport

        return MeshTransport(priority=priority, offline=offline)
    from rose.io.udp import UdpTransport

    return UdpTransport(hops=hops, dscp=dscp_of(priority))


class Runner:
    """One service and its program."""

    def __init__(self, service: Service, program: type[Program]) -> None:
        self._service, self._program = service, program
        self._task: asyncio.Task[None] | None = None
        self._ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        service.on_command_from(Configure, self._configure)

    async def wait(self) -> None:
        """Return when the program has ended by itself; raise what it raised."""
        await self._ended

    async def stop(self) -> None:
        """End the program."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def _configure(self, command: Command) -> Message:
        if not (command.is_local or self._service.is_sealed or command.sender.host.is_loopback):
            raise RoseError("takes settings from its own host, or sealed; give it keys")
        assert isinstance(command.message, Configure)
        settings = settings_of(self._program, command.message.settings)
        await self.stop()
        self._task = asyncio.get_running_loop().create_task(self._run(settings))
        return Done()

    async def _run(self, settings: msgspec.Struct) -> None:
        try:
            await self._program(self._service, settings).run()
        except Exception as error:
            if not self._ended.done():
                self._ended.set_exception(error)
        else:
            if not self._ended.done():
                self._ended.set_result(None)


def _end_with_manager(stopping: asyncio.Event) -> None:
    """The Service Manager holds the other end of standard input: when it is gone, however it went, so is this."""
    if not os.read(sys.stdin.fileno(), 4096):
        asyncio.get_running_loop().remove_reader(sys.stdin)
        stopping.set()


async def _serve(start: Start) -> None:
    program = load_program(start.run)
    transport = make_transport(start.transport, priority=start.priority, offline=start.offline, hops=start.hops)
    service = Service(start.sid, transport=transport, keys=_keys(start.keys), fresh_s=start.fresh_s)
    stopping = asyncio.Event()
    for signum in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(signum, stopping.set)
    asyncio.get_running_loop().add_reader(sys.stdin, _end_with_manager, stopping)
    async with service:
        runner = Runner(service, program)
        if start.ready_fd is not None:
            os.write(start.ready_fd, b"ready\n")
            os.close(start.ready_fd)
        tasks = [asyncio.ensure_future(runner.wait()), asyncio.ensure_future(stopping.wait())]
        done, pending = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in pending:
            task.cancel()
        await runner.stop()
        for task in done:
            task.result()


def main() -> int:
    """Run one service; 0 when it ended by itself or was told to, 1 with a line on stderr when it could not go on."""
    start = msgspec.json.decode(sys.stdin.readline(), type=Start)
    try:
        asyncio.run(_serve(start))
    except (RoseError, CallError, OSError) as error:
        print(f"{start.sid}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
