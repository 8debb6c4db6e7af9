"""One run of a scenario in a lab that is up: discovery, t = 0, events and traffic, drain, end.

Theory. t = 0 is when every process is ready, a mesh has routes between the ends of the streams (at most
``DISCOVERY_LIMIT_S`` are waited for them) and then each traffic source has discovered the destinations it can reach (at
most as long again). Traffic is published in [0, duration); one second of drain follows.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from enum import StrEnum
from typing import Any

from netlab.engines.base import LabPlan
from netlab.errors import LabError
from netlab.lab.effects import Effects
from netlab.lab.parts import Parts
from netlab.lab.playback import Playback
from netlab.lab.process import Process, ProcessSpec, describe_status
from netlab.lab.programs import DISCOVERY_LIMIT_S, SINK, SOURCE
from netlab.lab.readiness import READY_LIMIT_S
from netlab.lab.run_clock import RunClock
from netlab.lab.traffic_run import TrafficRun
from netlab.timeline import Entry

DRAIN_S = 1.0
_START_LEAD_NS = 30_000_000  # so that every source has the start command before t = 0
_ROUTES_POLL_S = 0.05
_ENDLESS_S = 1e9  # for as long as a person holds the timeline


class Phase(StrEnum):
    """How far a lab's scenario has come."""

    READY = "ready"
    DISCOVERING = "discovering"
    RUNNING = "running"
    DRAINING = "draining"
    FINISHED = "finished"


class ScenarioRun:
    """Runs a scenario once. ``problems``: what went wrong of the scenario, for a person."""

    def __init__(
        self,
        parts: Parts,
        *,
        plan_at_start: LabPlan,
        specs_of: Callable[[str], list[ProcessSpec]],
        has_routes: Callable[[], bool],
    ) -> None:
        """Get ready.

        Args:
            parts: The lab.
            plan_at_start: Its plan with only those pairs that are in range at the start.
            specs_of: The processes of a node.
            has_routes: Whether every stream of a mesh has a route yet; asked before t = 0.
        """
        self.phase = Phase.READY
        self.problems: list[str] = []
        self._parts = parts
        self._has_routes = has_routes
        self._clock = RunClock()
        self._traffic = TrafficRun(parts.scenario, plan_at_start, parts.processes)
        self.effects = Effects(parts, self._clock, self._traffic, specs_of, self.problems.append)
        self.playback = Playback(parts, self._clock, self.effects, self.problems.append)
        self._phase_changed = asyncio.Event()
        self._started = asyncio.Event()

    @property
    def t_s(self) -> float | None:
        """Run time, None before t = 0 is set."""
        return self._clock.t_s

    @property
    def t0_ns(self) -> int | None:
        """When t = 0 is (CLOCK_REALTIME), None before it is set."""
        return self._clock.t0_ns

    @property
    def streams(self) -> dict[int, dict[str, Any]]:
        """The live figures of each stream by number."""
        return self._traffic.streams

    async def run(self) -> None:
        """Run to the end; a failure to start traffic is raised.

        Raises:
            LabError: A traffic process could not start.
        """
        await self._begin()
        await self._clock.sleep_until(0.0)
        recording = self._parts.recording
        recording.timeline("start", "t = 0", at_s=0.0)
        self._enter(Phase.RUNNING)
        self._started.set()
        await self.playback.play()
        end_s = self.playback.end_s
        recording.timeline("end", "the scenario's duration is over", at_s=end_s)
        self._enter(Phase.DRAINING)
        await self._clock.sleep_until(end_s + DRAIN_S)
        await self._traffic.stop()

    async def _begin(self) -> None:
        """Start the traffic, and set t = 0."""
        self._enter(Phase.DISCOVERING)
        # Routes first: a peer that was discovered by a broadcast, but that no route leads to yet, comes and goes.
        routes_by_s = time.monotonic() + DISCOVERY_LIMIT_S
        while not self._has_routes() and time.monotonic() < routes_by_s:
            await asyncio.sleep(_ROUTES_POLL_S)
        sources = await self._traffic.start(self._parts.scenario.at_rest, DISCOVERY_LIMIT_S + READY_LIMIT_S)
        t0_ns = self._clock.t0_ns = time.time_ns() + _START_LEAD_NS
        self._parts.recording.set_t0(t0_ns)
        self._parts.recording.links(self._parts.links.describe())
        self._traffic.begin(sources, t0_ns, late=False)
        self._parts.motion.begin(t0_ns)

    def hold(self) -> None:
        """Let the timeline and all motion stand still; processes, radios and traffic go on. See ``Schedule``.

        Raises:
            LabError: It stands still already, or the scenario is not running.
        """
        if not self.playback.is_held:
            self._check_running()
        self.playback.hold()
        self._traffic.set_duration(_ENDLESS_S)

    def resume(self) -> None:
        """Let the timeline go on. Raises LabError when it does."""
        self.playback.resume()
        self._traffic.set_duration(self.playback.end_s)
        self._parts.recording.set_duration(self.playback.end_s)

    async def step(self) -> list[Entry]:
        """Carry out the next moment of the timeline now; returns its entries.

        Raises:
            LabError: Nothing comes any more, or the scenario is not running.
        """
        self._check_running()
        return await self.playback.step()

    def _check_running(self) -> None:
        if self.phase is not Phase.RUNNING:
            raise LabError(f"the scenario is {self.phase}; its timeline goes from t = 0 to its end")

    async def wait_for_phase(self, phase: Phase) -> None:
        """Return when that phase has been reached."""
        while self.phase is not phase:
            changed = self._phase_changed
            await changed.wait()

    async def wait_until(self, at_s: float) -> None:
        """Return at a run time."""
        await self._started.wait()
        await self._clock.sleep_until(at_s)

    def finish(self) -> None:
        """Mark the end, after the capture has been closed."""
        self._enter(Phase.FINISHED)

    def process_ended(self, process: Process) -> None:
        """A process ended; unless that was asked for, it is a problem that the run reports."""
        status = process.exit_status if process.exit_status is not None else 0
        if status != 0 or process.spec.name not in (SOURCE, SINK):  # traffic that came to its end is no news
            text = f"{process.spec.node}: {process.spec.name} {describe_status(status)}"
            self._parts.recording.timeline("exit", text, at_s=self.t_s)
        if not process.stopping and status != 0:
            self.problems.append(process.describe_failure())

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._phase_changed.set()
        self._phase_changed = asyncio.Event()
