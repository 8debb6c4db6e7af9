"""What the control socket can ask of a running lab: one method per request, named ``_do_`` and the request's ``do``."""

from __future__ import annotations

import asyncio
import signal
from typing import Any, Protocol

from netlab.engines.base import LabPlan
from netlab.errors import LabError
from netlab.lab.control import Connection, Reply, Request
from netlab.lab.links import Links, parse_words
from netlab.lab.motion import Motion
from netlab.lab.process import State
from netlab.lab.processes import Processes, kill_group
from netlab.lab.recording import Recording
from netlab.lab.scenario_run import READY_LIMIT_S, Phase, ScenarioRun, wait_for_state, wait_ready
from netlab.medium.impairments import PERFECT
from netlab.medium.segments import SegmentKind
from netlab.timeline import Kind, MoveNode, SetPairs
from netlab.timeline.impairments import impairment


class RunningLab(Protocol):
    """The parts of a lab that requests act on."""

    plan: LabPlan
    links: Links
    processes: Processes
    recording: Recording
    motion: Motion
    run: ScenarioRun

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
        if method is None:
            raise LabError(f"unknown request {request.get('do')!r}")
        reply: Reply | None = await method(request, fds, connection)
        return reply

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
        if node not in self._lab.plan.nodes:
            raise LabError(f"there is no node '{node}'; nodes are {', '.join(self._lab.plan.nodes)}")
        if len(fds) != 3:
            raise LabError("exec takes three descriptors")
        tty = bool(request.get("tty"))
        pid, ended = self._lab.processes.execute(node, argv, request.get("env", {}), request["cwd"], fds, tty=tty)
        connection.send({"pid": pid})
        connection.on_close = lambda: _hang_up(pid, ended)
        status = await ended
        connection.on_close = lambda: None
        connection.send({"exit": status})

    async def _do_outage(self, request: Request, _fds: list[int], _connection: Connection) -> Reply:
        a, b = request["between"]
        pairs, _kind = self._lab.links.between(a, b, one_way=bool(request.get("one_way")))
        active = bool(request["active"])
        self._lab.links.set_outage("person", pairs, active=active)
        self._record_act("outage", f"outage {a}-{b} {'begins' if active else 'ends'}", None if active else (a, b))
        return {"ok": True}

    async def _do_carrier(self, request: Request, fds: list[int], connection: Connection) -> Reply:
        a, b = request["between"]
        pairs, kind = self._lab.links.between(a, b)
        if kind is not SegmentKind.WIRE:
            return await self._do_outage(request | {"active": not request["up"]}, fds, connection)
        up = bool(request["up"])
        if up:  # whole again, also where one direction was cut
            self._lab.links.set_outage("person", pairs, active=False)
        self._lab.links.set_carrier("person", {port for pair in pairs for port in pair}, up=up)
        self._record_act("carrier", f"link {a}-{b} {'up' if up else 'down'}", (a, b) if up else None)
        return {"ok": True}

    async def _do_link(self, request: Request, _fds: list[int], _connection: Connection) -> Reply:
        a, b = request["between"]
        pairs, _kind = self._lab.links.between(a, b, one_way=bool(request.get("one_way")))
        words = parse_words(a, b, request["words"])
        if words.rssi_dbm is not None and any(self._lab.links.signals.rssi_dbm(pair) is not None for pair in pairs):
            raise LabError(f"link {a} {b}: rssi follows places, or a measured file, here; move a node, or set loss")
        changes = {pair: impairment(words, self._lab.links.impairment(pair) or PERFECT) for pair in pairs}
        label = f"link {a}-{b}: " + ", ".join(f"{key}={value}" for key, value in request["words"].items())
        await self._lab.run.apply(SetPairs(changes), Kind.LINK, label, at_s=self._lab.run.t_s)
        return {"ok": True}

    async def _do_move(self, request: Request, _fds: list[int], _connection: Connection) -> Reply:
        node, to_m, speed_mps = request["node"], tuple(map(float, request["to"])), request.get("speed_mps")
        self._lab.motion.move(node, to_m, at_s=max(0.0, self._lab.run.t_s or 0.0), speed_mps=speed_mps)
        place = ", ".join(f"{value:g}" for value in to_m)
        await self._lab.run.apply(MoveNode(node), Kind.MOVE, f"move {node} to [{place}]", at_s=self._lab.run.t_s)
        return {"ok": True}

    async def _do_kill(self, request: Request, _fds: list[int], _connection: Connection) -> Reply:
        process = self._lab.processes.get(request["node"], request["process"])
        self._lab.processes.stop(process, signal.SIGKILL)
        await wait_for_state(process, State.EXITED, 5.0)
        return {"ok": True}

    async def _do_start(self, request: Request, _fds: list[int], _connection: Connection) -> Reply:
        process = self._lab.processes.get(request["node"], request["process"])
        if process.state is not State.EXITED:
            raise LabError(f"{request['node']}: {request['process']} is {process.state} already")
        self._lab.processes.start(process.spec)
        await wait_ready([process], READY_LIMIT_S)
        return {"ok": True}

    async def _do_down(self, _request: Request, _fds: list[int], _connection: Connection) -> Reply:
        asyncio.get_running_loop().call_later(0.01, self._lab.end)  # after the answer is out
        return {"ok": True}

    def _record_act(self, kind: str, label: str, restores: tuple[str, str] | None) -> None:
        self._lab.recording.timeline(kind, label, at_s=self._lab.run.t_s, restores=list(restores) if restores else None)
        self._lab.recording.links(self._lab.links.describe())


def _hang_up(pid: int, ended: asyncio.Future[int]) -> None:
    """The one who ran the command is gone: as when a terminal closes, and no later."""
    if not ended.done():
        kill_group(pid, signal.SIGHUP)
        kill_group(pid, signal.SIGKILL)
