"""What an action of the timeline does to a running lab, and its record."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Sequence
from typing import Any

from netlab.engines.base import Pair
from netlab.errors import LabError
from netlab.lab.links import TIMELINE, carried
from netlab.lab.parts import Parts
from netlab.lab.process import ProcessSpec, State
from netlab.lab.readiness import READY_LIMIT_S, wait_for_state, wait_ready
from netlab.lab.run_clock import RunClock
from netlab.lab.traffic_run import TrafficRun
from netlab.timeline import (
    Action,
    DeployNode,
    HoldMotion,
    KillProcess,
    MoveNode,
    Nothing,
    SetCarrier,
    SetOutage,
    SetPairs,
    StartProcess,
)

EXIT_LIMIT_S = 5.0


class Effects:
    """Carries actions out on one lab. What fails beside its caller is told to ``on_problem``."""

    def __init__(
        self,
        parts: Parts,
        clock: RunClock,
        traffic: TrafficRun,
        specs_of: Callable[[str], list[ProcessSpec]],
        on_problem: Callable[[str], None],
    ) -> None:
        """``specs_of``: the processes of a node that is about to come to life."""
        self._parts = parts
        self._clock = clock
        self._traffic = traffic
        self._specs_of = specs_of
        self._on_problem = on_problem
        self._arrivals: set[asyncio.Task[None]] = set()

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
        await self._carry_out(action)
        if (restores := joins.get("restores")) and not self._parts.motion.in_contact(*map(str, restores)):
            joins.pop("restores")
        origin = {key: value for key, value in (("event", event), ("act", act)) if value is not None}
        meaning: dict[str, Any] = {"restores": None, **joins, **origin}
        self._parts.recording.timeline(kind, label, at_s=at_s, **meaning)
        if isinstance(action, SetPairs | SetOutage | SetCarrier | DeployNode):
            self._parts.recording.links(self._parts.links.describe())

    async def _carry_out(self, action: Action) -> None:
        links, processes = self._parts.links, self._parts.processes
        match action:
            case SetPairs(changes):
                links.set_pairs(dict(changes))
            case SetOutage(pairs, active):
                links.set_outage(TIMELINE, set(pairs), active=active)
            case SetCarrier(ports, up):
                links.set_carrier(TIMELINE, set(ports), up=up)
            case KillProcess(node, process):
                processes.stop(processes.get(node, process), signal.SIGKILL)
            case StartProcess(node, process):
                await self._start_again(node, process)
            case DeployNode(node, pairs):
                self._deploy(node, set(pairs))
            case HoldMotion(active):
                standstill = self._parts.motion.standstill
                (standstill.hold if active else standstill.release)(TIMELINE, self._clock.now_s)
            case MoveNode() | Nothing():
                pass  # the motions say where it is

    async def _start_again(self, node: str, name: str) -> None:
        """Start a process that was killed or ended; a failure is a problem of the run, not its end."""
        process = self._parts.processes.get(node, name)
        if process.state is not State.EXITED:
            await wait_for_state(process, State.EXITED, EXIT_LIMIT_S)
        try:
            self._parts.processes.start(process.spec)
        except LabError as error:
            self._on_problem(str(error))

    def _deploy(self, node: str, pairs: set[Pair]) -> None:
        """Put a node that was carried on the air, and bring its processes to life while the timeline goes on."""
        self._parts.links.set_outage(carried(node), pairs, active=False)
        task = asyncio.create_task(self._come_alive(node))
        self._arrivals.add(task)
        task.add_done_callback(self._arrivals.discard)

    async def _come_alive(self, node: str) -> None:
        assert self._clock.t0_ns is not None  # nothing is deployed before
        try:
            await wait_ready([self._parts.processes.start(spec) for spec in self._specs_of(node)], READY_LIMIT_S)
            sources = await self._traffic.start([node], READY_LIMIT_S)
            self._traffic.begin(sources, self._clock.t0_ns, late=True)
        except LabError as error:
            self._on_problem(f"{node}: {error}")
