"""The lab's PID 1: builds the lab, starts its processes, serves the control socket, ends everything.

Started by ``netlab.lab.launch``. It reads the scenario from its folder, brings the engine up, starts the recorder and
the fork server, waits until every process has reported ready and says so on the ready descriptor. From then on it does
what the control socket asks. It ends on SIGTERM and on ``down``.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import pickle
import resource
import signal
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from netlab.errors import MachineError, NetlabError
from netlab.kernel import syscalls
from netlab.lab.acts import Acts
from netlab.lab.assembly import bring_up_network, make_parts, make_run, start_processes
from netlab.lab.box import run_in_box
from netlab.lab.control import ControlServer
from netlab.lab.launch import LaunchOptions, log_tail
from netlab.lab.registry import LabFolder
from netlab.lab.requests import Requests
from netlab.lab.stalls import StallWatch
from netlab.scenario.model import Scenario


class Supervisor:
    """One lab. ``build`` makes it, ``serve`` keeps it until it is told to end; the rest is for ``Requests``."""

    def __init__(self, folder: LabFolder, scenario: Scenario, options: LaunchOptions) -> None:
        self._folder = folder
        self._scenario = scenario
        self._options = options
        self._ending = asyncio.Event()
        self._recorder_stats: dict[str, Any] | None = None
        self._used: list[dict[str, Any]] = []
        self._notices: list[str] = []
        self._failures: list[str] = []
        self._scenario_task: asyncio.Task[None] | None = None
        self._stalls = StallWatch()

    async def build(self, tell: Callable[[str], None]) -> None:
        """Bring everything up; ``tell`` hears what is being done. Raises NetlabError with a text for a person."""
        loop = asyncio.get_running_loop()
        for signum in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            loop.add_signal_handler(signum, self._ending.set)
        loop.add_signal_handler(signal.SIGCHLD, _reap_orphans)
        self._network = bring_up_network(self._scenario, self._options.engine, tell)
        self.parts = make_parts(self._network, self._options, self._folder)
        self.parts.processes.on_lost = lambda: self._fail("the lab's fork server ended; no process is watched any more")
        self.parts.motion.on_failure = self._fail
        self.run = make_run(self._network, self.parts, self._folder.path)
        await start_processes(self._network, self.parts, self._folder.path, tell)
        self.acts = Acts(self.parts, self.run)
        self._control = ControlServer(self._folder.control_socket, Requests(self).handle)

    # -- serving --------------------------------------------------------------------------------------------------

    async def serve(self) -> None:
        """Return when the lab is to end; everything is stopped then."""
        while not self._ending.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._ending.wait(), 0.5)
            self._notices += self.parts.recording.notices()
            if not self._failures and (problem := self._network.engine.problem()) is not None:
                self._fail(f"{problem}: {log_tail(self._folder)}")
        self.close()

    def _fail(self, text: str) -> None:
        """A part of the lab itself broke: the scenario ends here, for what follows would say nothing of the nodes."""
        if text not in self._failures and not self._ending.is_set():
            self._failures.append(text)
            if self._scenario_task is not None:
                self._scenario_task.cancel()

    def close(self) -> None:
        """Stop processes and finish the capture; the rest goes with PID 1."""
        self.parts.motion.end()
        for process in self.parts.processes.all():
            self.parts.processes.stop(process)
        self._close_recording()
        self._network.engine.close()

    def status(self) -> dict[str, Any]:
        """The lab as plain values, for commands."""
        return {
            "name": self._folder.name,
            "scenario": self._scenario.name,
            "seed": self.parts.plan.seed,
            "engine": self._network.engine_name,
            "phase": self.run.phase,
            "t_s": self.run.t_s,
            "t0_ns": self.run.t0_ns,
            "duration_s": self._scenario.duration_s,
            "end_s": self.run.playback.end_s,
            "held": self.run.playback.is_held,
            "coming": self.run.playback.coming(),
            "bring_up_s": self._network.bring_up_s,
            "nodes": list(self.parts.plan.nodes),
            "processes": [process.describe() for process in self.parts.processes.all()],
            "links": [{key: row[key] for key in ("from", "to", "state")} for row in self.parts.links.describe()],
            "streams": self.run.streams,
            "problems": self.run.problems,
            "notices": self._notices,
            "failures": self._failures,
            "worst_stall_s": self._stalls.worst_s,
            "medium": self._network.engine.timing(),
            "capture": str(self._options.capture) if self._options.capture else None,
            "recording": self.parts.recording.file,
            "undo": self.acts.next_undo,
            "recorder": self._recorder_stats,
            "used": self._used,
        }

    def begin_scenario(self) -> asyncio.Task[None]:
        """Start the scenario; the task ends with it, or with what kept it from beginning."""
        self._scenario_task = asyncio.create_task(self._run_scenario())
        return self._scenario_task

    def end(self) -> None:
        """Have the lab end."""
        self._ending.set()

    async def _run_scenario(self) -> None:
        watching = asyncio.create_task(self._stalls.run())
        try:
            await self.run.run()
        except asyncio.CancelledError:  # a failure, which stands in the status
            pass
        except Exception as error:
            if self.run.t0_ns is None:
                raise
            self._failures.append(f"the scenario could not go on: {error!r}")
        finally:
            watching.cancel()
        self._used = [{**process.identity(), **asdict(process.usage())} for process in self.parts.processes.all()]
        self._close_recording()
        self.run.finish()

    def _close_recording(self) -> None:
        self._notices += self.parts.recording.notices()
        if self.parts.recording.active:
            try:
                self.parts.recording.links(self.parts.links.describe(counters=True))
            except MachineError as error:
                self._notices.append(str(error))
        stats = self.parts.recording.close()
        if stats is not None:
            self._recorder_stats = asdict(stats)


def _reap_orphans() -> None:
    """PID 1 inherits what daemons leave behind."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


class _Launcher:
    """Whoever started this lab and waits for it, at the other end of a pipe."""

    def __init__(self, ready_fd: int) -> None:
        self._ready_fd = ready_fd

    def stage(self, what: str) -> None:
        """Tell how far the lab is."""
        self._write({"stage": what})

    def ready(self) -> None:
        """Tell that it is up, and hang up."""
        self._end({"ok": True})

    def failed(self, text: str, kind: str) -> None:
        """Tell what kept it from coming up (``kind``: ``machine`` or ``lab``), and hang up."""
        self._end({"error": text, "kind": kind})

    def _end(self, answer: dict[str, Any]) -> None:
        self._write(answer)
        os.close(self._ready_fd)

    def _write(self, told: dict[str, Any]) -> None:
        os.write(self._ready_fd, json.dumps(told).encode() + b"\n")


async def _main(folder: LabFolder, launcher: _Launcher) -> int:
    scenario, options = pickle.loads((folder.path / "scenario.pickle").read_bytes())
    try:
        supervisor = Supervisor(folder, scenario, options)
        await supervisor.build(launcher.stage)
    except NetlabError as error:
        launcher.failed(str(error), "machine" if isinstance(error, MachineError) else "lab")
        return 1
    launcher.ready()
    await supervisor.serve()
    return 0


def main(argv: list[str]) -> int:
    """Enter the box and run the lab in it."""
    parser = argparse.ArgumentParser(prog="netlab-supervisor")
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--lock-fd", type=int, required=True)  # held open, never used: the folder is ours while we live
    parser.add_argument("--ready-fd", type=int, required=True)
    parser.add_argument("--lifeline-fd", type=int)
    options = parser.parse_args(argv)
    syscalls.set_name("netlab")
    folder, launcher = LabFolder(options.folder), _Launcher(options.ready_fd)

    # Two descriptors per node and more per process: the usual soft limit of 1024 ends at some hundred nodes.
    _soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))

    def in_box() -> int:
        return asyncio.run(_main(folder, launcher))

    try:
        return run_in_box(in_box, lifeline_fd=options.lifeline_fd)
    except NetlabError as error:
        launcher.failed(str(error), "machine")
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
