"""One run of a scenario in a lab that is up: discovery, t = 0, events and traffic, drain, end.

Theory. t = 0 is when every process is ready, a mesh has routes between the ends of the streams (at most
``DISCOVERY_LIMIT_S`` are waited for them) and then each traffic source has discovered the destinations it can reach (at
most as long again). Traffic is published in [0, duration); one second of drain follows.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import time
from collections.abc import Callable, Sequence
from enum import StrEnum
from itertools import groupby
from typing import Any

from netlab.engines.base import LabPlan, Pair
from netlab.errors import LabError, NetlabError
from netlab.lab.links import Links
from netlab.lab.process import Process, ProcessSpec, State, describe_status
from netlab.lab.processes import Processes
from netlab.lab.programs import DISCOVERY_LIMIT_S, SINK, SOURCE, traffic_sinks, traffic_sources
from netlab.lab.recording import Recording
from netlab.scenario.model import Scenario
from netlab.timeline import (
    Action,
    DeployNode,
    Entry,
    HoldMotion,
    KillProcess,
    MeshRoutes,
    MoveNode,
    Nothing,
    Schedule,
    SetCarrier,
    SetOutage,
    SetPairs,
    StartProcess,
    compile_timeline,
)
from netlab.timeline.schedule import Standstill

DRAIN_S = 1.0
_START_LEAD_NS = 30_000_000  # so that every source has the start command before t = 0
READY_LIMIT_S = 20.0
_ROUTES_POLL_S = 0.05
_PERSON, _TIMELINE = "person", "timeline"  # who holds motion
_COMING = 40  # entries that a status tells of
_ENDLESS_S = 1e9  # for as long as a person holds the timeline


class Phase(StrEnum):
    """How far a lab's scenario has come."""

    READY = "ready"
    DISCOVERING = "discovering"
    RUNNING = "running"
    DRAINING = "draining"
    FINISHED = "finished"


class ScenarioRun:
    """Runs a scenario once. ``streams`` holds the live figures of each stream by number."""

    def __init__(
        self, scenario: Scenario, plan: LabPlan, links: Links, processes: Processes, recording: Recording
    ) -> None:
        self.scenario = scenario
        self._plan = plan
        #: The same, with only those pairs that are in range at the start, when sources wait to discover them.
        self.plan_at_start = plan
        self._links = links
        self._processes = processes
        self._recording = recording
        self.phase = Phase.READY
        self.t0_ns: int | None = None
        self.problems: list[str] = []
        self.streams: dict[int, dict[str, Any]] = {}
        #: Whether every stream of a mesh has a route yet; asked before t = 0.
        self.has_routes: Callable[[], bool] = lambda: True
        #: Whether two nodes can hear each other when nothing holds them down.
        self.in_contact: Callable[[str, str], bool] = lambda _a, _b: True
        #: The pairs of radio ports in contact, where only that tells who is in range.
        self.contacts: Callable[[], frozenset[Pair]] | None = None
        #: The processes of a node that has just been dropped.
        self.specs_of: Callable[[str], list[ProcessSpec]] = lambda _node: []
        self.on_start: Callable[[int], None] = lambda _t0_ns: None
        #: A move or a deployment of the scenario comes before its time; gets its place in `events`.
        self.forestall: Callable[[int], None] = lambda _event: None
        self.schedule = Schedule(compile_timeline(scenario, plan))
        self.motion_standstill = Standstill()
        self._routes: MeshRoutes | None = None
        self._retimed = asyncio.Event()
        self._arrivals: set[asyncio.Task[None]] = set()
        self._sources: list[Process] = []
        self._sinks: list[Process] = []
        self._phase_changed = asyncio.Event()
        self._started = asyncio.Event()

    @property
    def t_s(self) -> float | None:
        """Scenario time, None before t = 0."""
        return None if self.t0_ns is None else (time.time_ns() - self.t0_ns) / 1e9

    async def run(self) -> None:
        """Run to the end; a failure to start traffic is raised.

        Raises:
            LabError: A traffic process could not start.
        """
        self._enter(Phase.DISCOVERING)
        # Routes first: a peer that was discovered by a broadcast, but that no route leads to yet, comes and goes.
        routes_by_s = time.monotonic() + DISCOVERY_LIMIT_S
        while not self.has_routes() and time.monotonic() < routes_by_s:
            await asyncio.sleep(_ROUTES_POLL_S)
        await self._start_traffic(self.scenario.at_rest, DISCOVERY_LIMIT_S + READY_LIMIT_S)
        self.t0_ns = time.time_ns() + _START_LEAD_NS
        self._recording.set_t0(self.t0_ns)
        self._recording.links(self._links.describe())
        for process in self._sources:
            self._tell_to_begin(process, late=False)
        self.on_start(self.t0_ns)
        await self._sleep_until(0.0)
        self._recording.timeline("start", "t = 0", at_s=0.0)
        self._enter(Phase.RUNNING)
        self._started.set()
        if self.contacts is not None and self._plan.meshes:
            self._routes = MeshRoutes(self.scenario, self._plan)
        await self._play()
        end_s = self.end_s
        self._recording.timeline("end", "the scenario's duration is over", at_s=end_s)
        self._enter(Phase.DRAINING)
        await self._sleep_until(end_s + DRAIN_S)
        await self._stop_traffic()

    @property
    def end_s(self) -> float:
        """When the run's duration is over, as far as is known: holds make it longer."""
        return self.scenario.duration_s + self.schedule.standstill.total_s(self.t_s or 0.0)

    def coming(self) -> list[dict[str, Any]]:
        """The next moments of the timeline as plain values; ``at_s`` is run time, if nothing holds it from now on."""
        now_s = self.t_s or 0.0
        return [
            {"at_s": self.schedule.run_s(entry.at_s, now_s), "kind": entry.kind, "label": entry.label}
            for entry in self.schedule.coming[:_COMING]
        ]

    def hold(self) -> None:
        """Let the timeline and all motion stand still; processes, radios and traffic go on. See ``Schedule``.

        Raises:
            LabError: It stands still already, or the scenario is not running.
        """
        if self.schedule.is_held or self.phase is not Phase.RUNNING:
            raise LabError("the timeline stands still already" if self.schedule.is_held else self._not_running)
        for standstill in (self.schedule.standstill, self.motion_standstill):
            standstill.hold(_PERSON, self._now_s)
        self._tell_duration(_ENDLESS_S)
        self._retimed.set()

    def resume(self) -> None:
        """Let the timeline go on. Raises LabError when it does."""
        if not self.schedule.is_held:
            raise LabError("the timeline is going on")
        for standstill in (self.schedule.standstill, self.motion_standstill):
            standstill.release(_PERSON, self._now_s)
        self._tell_duration(self.end_s)
        self._recording.set_duration(self.end_s)
        self._retimed.set()

    async def step(self) -> list[Entry]:
        """Carry out the next moment of the timeline now.

        Raises:
            LabError: Nothing comes any more, or the scenario is not running.
        """
        if self.phase is not Phase.RUNNING or not self.schedule.coming:
            raise LabError("nothing comes any more" if self.phase is Phase.RUNNING else self._not_running)
        entries = self.schedule.step(self._now_s)
        for entry in entries:
            if isinstance(entry.action, MoveNode | DeployNode) and entry.event is not None:
                self.forestall(entry.event)
        await self._carry_out(entries)
        self._retimed.set()
        return entries

    @property
    def _not_running(self) -> str:
        return f"the scenario is {self.phase}; its timeline goes from t = 0 to its end"

    async def _play(self) -> None:
        """Carry the timeline out; returns at the end of the duration."""
        while True:
            for _, moment in groupby(self.schedule.take_due(self._now_s), key=lambda entry: entry.at_s):
                await self._carry_out(list(moment))
            now_s, coming = self._now_s, self.schedule.coming
            if not self.schedule.is_held and not coming and now_s >= self.end_s:
                return
            due_s = self.schedule.next_due_s(now_s)
            wait_s = None if self.schedule.is_held else (self.end_s if due_s is None else due_s) - now_s
            self._retimed.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._retimed.wait(), wait_s)

    async def _carry_out(self, moment: Sequence[Entry]) -> None:
        """Carry out the entries of one moment, which count together as to who has to find another way."""
        if self._routes is not None and self.contacts is not None:
            moment = self._routes.mark(moment, self.contacts())
        for entry in moment:
            await self._follow(entry)

    async def _follow(self, entry: Entry) -> None:
        at_s = self.schedule.run_s(entry.at_s, self._now_s)
        try:
            at_s = min(at_s, self._now_s)
            await self.apply(entry.action, entry.kind, entry.label, at_s=at_s, event=entry.event, **_joins(entry))
        except NetlabError as error:
            self.problems.append(f"{entry.label}: {error}")

    @property
    def _now_s(self) -> float:
        assert self.t0_ns is not None
        return (time.time_ns() - self.t0_ns) / 1e9

    async def wait_for_phase(self, phase: Phase) -> None:
        """Return when that phase has been reached."""
        while self.phase is not phase:
            changed = self._phase_changed
            await changed.wait()

    async def wait_until(self, at_s: float) -> None:
        """Return at a scenario time."""
        await self._started.wait()
        await self._sleep_until(at_s)

    def finish(self) -> None:
        """Mark the end, after the capture has been closed."""
        self._enter(Phase.FINISHED)

    async def apply(
        self,
        action: Action,
        kind: str,
        label: str,
        *,
        at_s: float | None,
        event: int | None = None,
        act: dict[str, Any] | None = None,
        **joins: Sequence[Sequence[str]] | Sequence[str],
    ) -> None:
        """Do one timeline action and record it, with what it means for nodes that are joined (``Entry``'s names).

        ``event``: its place in the scenario's `events`; ``act``: the person's act that it is, see
        :mod:`netlab.lab.acts`.
        """
        match action:
            case SetPairs(changes):
                self._links.set_pairs(dict(changes))
            case SetOutage(pairs, active):
                self._links.set_outage("timeline", set(pairs), active=active)
            case SetCarrier(ports, up):
                self._links.set_carrier("timeline", set(ports), up=up)
            case KillProcess(node, process):
                self._processes.stop(self._processes.get(node, process), signal.SIGKILL)
            case StartProcess(node, process):
                await self.start_process(node, process)
            case DeployNode(node, pairs):
                self._deploy(node, set(pairs))
            case HoldMotion(active):
                change = self.motion_standstill.hold if active else self.motion_standstill.release
                change(_TIMELINE, self._now_s)
            case MoveNode() | Nothing():
                pass  # the motions say where it is
        if (restores := joins.get("restores")) and not self.in_contact(*map(str, restores)):
            joins.pop("restores")
        origin = {key: value for key, value in (("event", event), ("act", act)) if value is not None}
        meaning: dict[str, Any] = {"restores": None, **joins, **origin}
        self._recording.timeline(kind, label, at_s=at_s, **meaning)
        if isinstance(action, SetPairs | SetOutage | SetCarrier | DeployNode):
            self._recording.links(self._links.describe())

    async def start_process(self, node: str, name: str) -> None:
        """Start a process again that was killed or ended; a failure is a problem of the run, not its end."""
        process = self._processes.get(node, name)
        if process.state is not State.EXITED:
            await wait_for_state(process, State.EXITED, 5.0)
        try:
            self._processes.start(process.spec)
        except LabError as error:
            self.problems.append(str(error))

    def process_ended(self, process: Process) -> None:
        """A process ended; unless that was asked for, it is a problem that the run reports."""
        status = process.exit_status if process.exit_status is not None else 0
        if status != 0 or process.spec.name not in (SOURCE, SINK):  # traffic that came to its end is no news
            text = f"{process.spec.node}: {process.spec.name} {describe_status(status)}"
            self._recording.timeline("exit", text, at_s=self.t_s)
        if not process.stopping and status != 0:
            self.problems.append(process.describe_failure())

    def _deploy(self, node: str, pairs: set[Pair]) -> None:
        """Put a node that was carried on the air, and bring its processes to life while the timeline goes on."""
        self._links.set_outage(carried(node), pairs, active=False)
        task = asyncio.create_task(self._come_alive(node))
        self._arrivals.add(task)
        task.add_done_callback(self._arrivals.discard)

    async def _come_alive(self, node: str) -> None:
        try:
            await wait_ready([self._processes.start(spec) for spec in self.specs_of(node)], READY_LIMIT_S)
            for process in await self._start_traffic([node], READY_LIMIT_S):
                self._tell_to_begin(process, late=True)
        except LabError as error:
            self.problems.append(f"{node}: {error}")

    async def _start_traffic(self, nodes: Sequence[str], limit_s: float) -> list[Process]:
        """Start the sinks, then the sources of some nodes; returns those sources."""
        wanted = [spec for spec in traffic_sinks(self.scenario) if spec.node in nodes]
        self._sinks += await self._start_ready(wanted, READY_LIMIT_S)
        wanted = [spec for spec in traffic_sources(self.scenario, self.plan_at_start) if spec.node in nodes]
        sources = await self._start_ready(wanted, limit_s)
        self._sources += sources
        return sources

    def _tell_to_begin(self, process: Process, *, late: bool) -> None:
        duration_s = _ENDLESS_S if self.schedule.is_held else self.end_s
        _send(process, {"t0_ns": self.t0_ns, "duration_s": duration_s, "late": late})

    def _tell_duration(self, duration_s: float) -> None:
        for process in self._sources:
            _send(process, {"duration_s": duration_s})

    async def _start_ready(self, specs: list[ProcessSpec], limit_s: float) -> list[Process]:
        started = [self._processes.start(spec) for spec in specs]
        for process in started:
            assert process.command is not None  # traffic processes take commands
            asyncio.get_running_loop().add_reader(process.command.fileno(), self._on_report, process)
        await wait_ready(started, limit_s)
        return started

    def _on_report(self, process: Process) -> None:
        assert process.command is not None
        try:
            data = process.command.recv(1 << 18)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            asyncio.get_running_loop().remove_reader(process.command.fileno())
            return
        for row in json.loads(data):
            self.streams.setdefault(row["stream"], {}).update(row)

    async def _stop_traffic(self) -> None:
        for process in self._sinks:
            _send(process, {"stop": True})
        for process in (*self._sources, *self._sinks):
            process.stopping = True
            try:
                await wait_for_state(process, State.EXITED, 2.0)
            except LabError:
                self._processes.stop(process, signal.SIGKILL)

    async def _sleep_until(self, at_s: float) -> None:
        assert self.t0_ns is not None
        deadline_ns = self.t0_ns + round(at_s * 1e9)
        while (left_s := (deadline_ns - time.time_ns()) / 1e9) > 0:
            await asyncio.sleep(left_s)

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._phase_changed.set()
        self._phase_changed = asyncio.Event()


def carried(node: str) -> str:
    """Who holds the pairs of a node down that is still carried."""
    return f"carried {node}"


def _joins(entry: Entry) -> dict[str, Any]:
    named = {"restores": entry.restores, "reroutes": entry.reroutes, "rejoins": entry.rejoins}
    return {key: value for key, value in named.items() if value}


async def wait_ready(processes: list[Process], limit_s: float, tell: Callable[[str], None] = lambda what: None) -> None:
    """Return when all are ready; one that reports no readiness and came to a good end has done its work.

    ``tell`` hears how far it is.

    Raises:
        LabError: One ended first, or is not ready in time; with its argv, exit code and last log lines.
    """
    for number, process in enumerate(processes):
        tell(f"starting processes: {number} of {len(processes)} ready")
        if process.spec.waits_for_ready or process.exit_status != 0:
            await wait_for_state(process, State.READY, limit_s)


async def wait_for_state(process: Process, state: State, limit_s: float) -> None:
    """Return when a process has come into ``state``. Raises LabError when it ended instead, or at the limit."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(limit_s):
            while process.state is not state:
                if process.state is State.EXITED:
                    raise LabError(process.describe_failure())
                await process.changed.wait()
    if process.state is not state:
        raise LabError(f"not {state} within {limit_s:.0f} s: {process.describe_failure()}")


def _send(process: Process, message: dict[str, Any]) -> None:
    if process.command is not None:
        with contextlib.suppress(OSError):  # a process that is gone shows in its exit status
            process.command.send(json.dumps(message).encode())
