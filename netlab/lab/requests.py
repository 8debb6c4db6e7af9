"""What the control socket can ask of a running lab: one method per request, named ``_do_`` and the request's ``do``.

What changes the lab is in :mod:`netlab.lab.acts`.
"""

from __future__ import annotations

import asyncio
import signal
from typing import Any, Protocol

from netlab.errors import LabError
from netlab.lab.acts import Acts
from netlab.lab.control import Connection, Reply, Request
from netlab.lab.parts import Parts
from netlab.lab.processes import kill_group
from netlab.lab.scenario_run import Phase, ScenarioRun


class RunningLab(Protocol):
    """A lab as requests see it."""

    parts: Parts
    run: ScenarioRun
    acts: Acts

    def status(self) -> dict[str, Any]: ...
    def begin_scenario(self) -> asyncio.Task[None]: ...
    def end(self) -> None: ...


class Requests:
    """Answers the control socket's requests for one lab."""

    def __init__(self, lab: RunningLab) -> None:
        self._lab = lab

    async def handle(self, request: Request, fds: list[int], connection: Connection) -> Reply | None:
        """Answer one control request; its ``do`` names a method ``_do_...``.

        Raises:
            LabError: Unknown request, or it cannot be done.
        """
        method = getattr(self, f"_do_{request.get('do')}", None)
        if method is not None:
            reply: Reply | None = await method(request, fds, connection)
            return reply
        done = await self._lab.acts.do(request)
        if done is None:
            raise LabError(f"unknown request {request.get('do')!r}")
        return done

    async def _do_status(self, _request: Request, _fds: list[int], _connection: Connection) -> Reply:
        return self._lab.status()

    async def _do_run(self, _request: Request, _fds: list[int], _connection: Connection) -> Reply:
        run = self._lab.run
        if run.phase is not Phase.READY:
            raise LabError(f"this lab's scenario is {run.phase} already; start another lab")
        task = self._lab.begin_scenario()
        begun = asyncio.create_task(run.wait_until(0.0))
        await asyncio.wait({task, begun}, return_when=asyncio.FIRST_COMPLETED)
        begun.cancel()
        if task.done():
            task.result()  # raises what kept it from beginning
        return {"ok": True, "t0_ns": run.t0_ns}

    async def _do_wait(self, request: Request, _fds: list[int], _connection: Connection) -> Reply:
        if "at_s" in request:
            await self._lab.run.wait_until(float(request["at_s"]))
        else:
            await self._lab.run.wait_for_phase(Phase(request["phase"]))
        return self._lab.status()

    async def _do_exec(self, request: Request, fds: list[int], connection: Connection) -> None:
        node, argv = request["node"], tuple(request["argv"])
        if node not in self._lab.parts.plan.nodes:
            raise LabError(f"there is no node '{node}'; nodes are {', '.join(self._lab.parts.plan.nodes)}")
        if len(fds) != 3:
            raise LabError("exec takes three descriptors")
        tty = bool(request.get("tty"))
        pid, ended = self._lab.parts.processes.execute(node, argv, request.get("env", {}), request["cwd"], fds, tty=tty)
        connection.send({"pid": pid})
        connection.on_close = lambda: _hang_up(pid, ended)
        status = await ended
        connection.on_close = lambda: None
        connection.send({"exit": status})

    async def _do_subscribe(self, request: Request, fds: list[int], _connection: Connection) -> Reply:
        if len(fds) != 1:
            raise LabError("subscribe takes one descriptor: a stream socket")
        self._lab.parts.recording.subscribe(fds[0], packets=bool(request.get("packets")))
        return {"ok": True}

    async def _do_down(self, _request: Request, _fds: list[int], _connection: Connection) -> Reply:
        asyncio.get_running_loop().call_later(0.01, self._lab.end)  # after the answer is out
        return {"ok": True}


def _hang_up(pid: int, ended: asyncio.Future[int]) -> None:
    """The one who ran the command is gone: as when a terminal closes, and no later."""
    if not ended.done():
        kill_group(pid, signal.SIGHUP)
        kill_group(pid, signal.SIGKILL)
