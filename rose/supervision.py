"""One service's process on this host: started, configured over loopback, started again when it ends, stopped."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import time
from collections.abc import Awaitable, Callable

import msgspec

from rose.config.model import ServiceConfig
from rose.core.addressing import ServiceId
from rose.core.keys import KeyRing
from rose.core.messages import Configure, Done, ServiceState
from rose.errors import CallError
from rose.runner import Start, keys_as_text
from rose.service import Service

FIRST_PAUSE_S, MOST_PAUSE_S = 0.5, 30.0
#: A process that has lived so long has its next restart at once again.
STEADY_S = 30.0
READY_WITHIN_S = 20.0
STOP_WITHIN_S = 3.0
CONFIGURE_WITHIN_S = 10.0


class Supervised:
    """Keeps one service running until :meth:`stop`."""

    def __init__(
        self, config: ServiceConfig, manager: Service, keys: KeyRing, fresh_s: float, say: Callable[[str], None]
    ) -> None:
        """``manager`` gives the settings; ``say`` takes the lines that the process writes."""
        self.config = config
        self.sid = ServiceId(manager.sid.host, config.robot, config.service)
        self.state, self.detail, self.restarts = "starting", "", 0
        self._manager, self._keys, self._fresh_s, self._say = manager, keys, fresh_s, say
        self._process: asyncio.subprocess.Process | None = None
        self._settled = asyncio.Event()
        self._task = asyncio.create_task(self._keep())

    def describe(self) -> ServiceState:
        """Return how it stands."""
        return ServiceState(str(self.sid), self.config.name, self.state, self.restarts, self.detail)

    async def settled(self) -> None:
        """Return when it runs for the first time, or has failed to."""
        await self._settled.wait()

    async def configure(self, config: ServiceConfig) -> None:
        """Give the running service other settings."""
        self.config = config
        if self.state in ("running", "failed") and self._process is not None and self._process.returncode is None:
            self.state = "running" if await self._send_settings() else "failed"

    async def stop(self) -> None:
        """End the process, by force if it takes longer than 3 s."""
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        process = self._process
        if process is not None and process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
            try:
                await asyncio.wait_for(process.wait(), STOP_WITHIN_S)
            except TimeoutError:
                process.kill()
                await process.wait()
        self.state = "ended"

    # -- inside ---------------------------------------------------------------------------------------------------

    async def _keep(self) -> None:
        pause_s = FIRST_PAUSE_S
        while True:
            started = time.monotonic()
            await self._once()
            self._settled.set()
            if not self.config.restart:
                return
            if time.monotonic() - started >= STEADY_S:
                pause_s = FIRST_PAUSE_S
            await asyncio.sleep(pause_s)
            pause_s = min(pause_s * 2, MOST_PAUSE_S)
            self.restarts += 1

    async def _once(self) -> None:
        """Run the process from start to end."""
        self.state = "starting"
        try:
            process, ready = await self._start()
        except OSError as error:
            self.state, self.detail = "failed", f"{(self.config.argv or (self.config.run,))[0]}: {error.strerror}"
            return
        self._process = process
        reading = asyncio.create_task(self._read(process))
        try:
            if await ready:
                self.state = "running" if await self._send_settings() else "failed"
                self._settled.set()  # one that refuses its settings stays, and may be given better ones
            status = await process.wait()
        finally:
            if process.returncode is None:
                reading.cancel()
        last = await reading
        self.state = "ended" if status == 0 else "failed"
        if status != 0 and not self.detail:
            self.detail = last or f"exit status {status}"

    async def _start(self) -> tuple[asyncio.subprocess.Process, Awaitable[bool]]:
        if self.config.argv:
            environment = os.environ | {"ROSE_SERVICE": str(self.sid)}
            process = await _spawn(self.config.argv, environment=environment)
            return process, _already()
        read_fd, write_fd = os.pipe()
        try:
            process = await _spawn((sys.executable, "-m", "rose.runner"), pass_fds=(write_fd,))
        except BaseException:
            os.close(read_fd)
            raise
        finally:
            os.close(write_fd)
        start = Start(
            sid=str(self.sid),
            run=self.config.run,
            keys=keys_as_text(self._keys),
            transport=self.config.transport,
            priority=self.config.priority,
            offline=self.config.offline,
            hops=self.config.hops,
            fresh_s=self._fresh_s,
            ready_fd=write_fd,
        )
        assert process.stdin is not None
        with contextlib.suppress(ConnectionError):  # it has ended already; its last line says why
            process.stdin.write(msgspec.json.encode(start) + b"\n")
            await process.stdin.drain()
        return process, _says_ready(read_fd)

    async def _send_settings(self) -> bool:
        if not self.config.run:
            return True
        command = Configure(self.config.settings)
        try:
            await self._manager.call(self.sid, command, Done, timeout_s=CONFIGURE_WITHIN_S, local=True)
        except CallError as error:
            self.detail = str(error)
            return False
        self.detail = ""
        return True

    async def _read(self, process: asyncio.subprocess.Process) -> str:
        """Pass on what the process writes; return its last line."""
        last = ""
        assert process.stdout is not None
        while line := await _line(process.stdout):
            last = line.decode(errors="replace").rstrip() or last
            self._say(f"{self.config.name}: {last}")
        return last


async def _spawn(
    argv: tuple[str, ...], *, environment: dict[str, str] | None = None, pass_fds: tuple[int, ...] = ()
) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        *argv,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        env=environment,
        pass_fds=pass_fds,
    )


async def _already() -> bool:
    return True


async def _says_ready(fd: int) -> bool:
    """Whether a process writes to ``fd`` before it closes it; takes the descriptor over."""
    loop = asyncio.get_running_loop()
    readable: asyncio.Future[None] = loop.create_future()
    os.set_blocking(fd, False)
    loop.add_reader(fd, _resolve, readable)
    try:
        await asyncio.wait_for(readable, READY_WITHIN_S)
        return bool(os.read(fd, 16))
    except TimeoutError:
        return False
    finally:
        loop.remove_reader(fd)
        os.close(fd)


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


async def _line(stream: asyncio.StreamReader) -> bytes:
    try:
        return await stream.readline()
    except ValueError:  # a line longer than the reader's buffer: it is thrown away
        return b"(a line that is too long)\n"
