"""The traffic processes of one run: started, told when to publish and for how long, their figures taken in, stopped."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
from collections.abc import Sequence
from typing import Any

from netlab.engines.base import LabPlan
from netlab.errors import LabError
from netlab.lab.process import Process, ProcessSpec, State
from netlab.lab.processes import Processes
from netlab.lab.programs import traffic_sinks, traffic_sources
from netlab.lab.readiness import READY_LIMIT_S, wait_for_state, wait_ready
from netlab.scenario.model import Scenario

_STOP_LIMIT_S = 2.0
_REPORT_BYTES = 1 << 18


class TrafficRun:
    """The sinks and sources of a run. ``streams`` holds the live figures of each stream by number."""

    def __init__(self, scenario: Scenario, plan: LabPlan, processes: Processes) -> None:
        """``plan``: with the pairs that are in range at the start, from which sources know whom to discover."""
        self.streams: dict[int, dict[str, Any]] = {}
        self._scenario = scenario
        self._plan = plan
        self._processes = processes
        self._duration_s = scenario.duration_s
        self._sources: list[Process] = []
        self._sinks: list[Process] = []

    async def start(self, nodes: Sequence[str], limit_s: float) -> list[Process]:
        """Start the sinks, then the sources of some nodes; returns those sources once they are ready.

        Args:
            nodes: Whose.
            limit_s: How long a source may take, discovery included.

        Raises:
            LabError: One could not start, or was not ready in time.
        """
        wanted = [spec for spec in traffic_sinks(self._scenario) if spec.node in nodes]
        self._sinks += await self._start_ready(wanted, READY_LIMIT_S)
        wanted = [spec for spec in traffic_sources(self._scenario, self._plan) if spec.node in nodes]
        sources = await self._start_ready(wanted, limit_s)
        self._sources += sources
        return sources

    def begin(self, sources: Sequence[Process], t0_ns: int, *, late: bool) -> None:
        """Have sources publish from t = 0, or (``late``) from now on."""
        for process in sources:
            _send(process, {"t0_ns": t0_ns, "duration_s": self._duration_s, "late": late})

    def set_duration(self, duration_s: float) -> None:
        """Have all sources, and those to come, publish until that run time."""
        self._duration_s = duration_s
        for process in self._sources:
            _send(process, {"duration_s": duration_s})

    async def stop(self) -> None:
        """Have all come to their end; what does not is killed."""
        for process in self._sinks:
            _send(process, {"stop": True})
        for process in (*self._sources, *self._sinks):
            process.stopping = True
            try:
                await wait_for_state(process, State.EXITED, _STOP_LIMIT_S)
            except LabError:
                self._processes.stop(process, signal.SIGKILL)

    async def _start_ready(self, specs: Sequence[ProcessSpec], limit_s: float) -> list[Process]:
        started = [self._processes.start(spec) for spec in specs]
        for process in started:
            assert process.command is not None  # traffic processes take commands
            asyncio.get_running_loop().add_reader(process.command.fileno(), self._on_report, process)
        await wait_ready(started, limit_s)
        return started

    def _on_report(self, process: Process) -> None:
        assert process.command is not None
        try:
            data = process.command.recv(_REPORT_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            asyncio.get_running_loop().remove_reader(process.command.fileno())
            return
        for row in json.loads(data):
            self.streams.setdefault(row["stream"], {}).update(row)


def _send(process: Process, message: dict[str, Any]) -> None:
    if process.command is not None:
        with contextlib.suppress(OSError):  # a process that is gone shows in its exit status
            process.command.send(json.dumps(message).encode())
