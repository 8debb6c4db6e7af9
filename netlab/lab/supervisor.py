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

from netlab.capture.layout import LAYOUT_NAME, layout_file
from netlab.capture.metadata import run_metadata
from netlab.clock import begin_in_step, clock_here
from netlab.engines import mesh_interfaces
from netlab.engines.base import LabPlan
from netlab.engines.choose import make_engine
from netlab.engines.plan import compile_plan, hosts
from netlab.errors import MachineError, NetlabError
from netlab.ipc import start_module
from netlab.kernel import syscalls
from netlab.lab.acts import Acts
from netlab.lab.box import run_in_box
from netlab.lab.control import ControlServer
from netlab.lab.isolation import keep_paths
from netlab.lab.launch import LaunchOptions, log_tail
from netlab.lab.links import Links
from netlab.lab.motion import set_in_motion
from netlab.lab.processes import Processes
from netlab.lab.programs import mesh_processes, node_processes, stream_routes
from netlab.lab.recording import Recording
from netlab.lab.registry import LabFolder
from netlab.lab.requests import Requests
from netlab.lab.scenario_run import READY_LIMIT_S, ScenarioRun, wait_ready
from netlab.lab.stalls import StallWatch
from netlab.scenario.model import Scenario
from netlab.timeline import SetPairs, compile_timeline

_NOT_FOR_NODES = ("XDG_RUNTIME_DIR", "UDP_MESH_SOCKET", "WNET_SOCKET")


class Supervisor:
    """One lab. ``build`` makes it, ``serve`` keeps it until it is told to end; the rest is for ``Requests``."""

    def __init__(self, folder: LabFolder, scenario: Scenario, options: LaunchOptions) -> None:
        self._folder = folder
        self._scenario = scenario
        self._options = options
        self.plan = mesh_interfaces.fitted(compile_plan(scenario))
        self._ending = asyncio.Event()
        self._bring_up_s = 0.0
        self._recorder_stats: dict[str, Any] | None = None
        self._used: list[dict[str, Any]] = []
        self._notices: list[str] = []
        self._failures: list[str] = []
        self._scenario_task: asyncio.Task[None] | None = None
        self._stalls = StallWatch()
        #: Told what is being done while the lab comes up.
        self.tell: Callable[[str], None] = lambda what: None

    # -- building -------------------------------------------------------------------------------------------------

    async def build(self) -> None:
        """Bring everything up. Raises NetlabError with a text for a person."""
        loop = asyncio.get_running_loop()
        for signum in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            loop.add_signal_handler(signum, self._ending.set)
        loop.add_signal_handler(signal.SIGCHLD, _reap_orphans)
        later = [
            change
            for entry in compile_timeline(self._scenario, self.plan)
            if isinstance(entry.action, SetPairs)
            for change in entry.action.changes.values()
            if change is not None
        ]
        mesh_interfaces.check_kernel(self.plan)
        self._engine_name, self._engine = make_engine(self._options.engine, self.plan, later)
        channel, _pid = start_module("netlab.lab.spawner")
        begin_in_step()
        self.tell(f"connecting {len(self.plan.nodes)} nodes")
        self._bring_up_s = self._engine.bring_up()
        self._bring_up_s += mesh_interfaces.bring_up(self.plan, self._engine.namespace_fds)
        self.links = Links(self.plan, self._engine)
        self.recording = self._start_recording()
        self.recording.journal = self._folder.journal
        self.processes = Processes(channel, self._folder.logs, _node_environment(), str(Path.cwd()))
        self.processes.open_events = self.recording.open_events
        self.processes.on_line = self.recording.line
        self.motion = set_in_motion(self._scenario, self.plan, self.links, self.recording)
        self.run = ScenarioRun(self._scenario, self.plan, self.links, self.processes, self.recording)
        self.run.plan_at_start = self._plan_at_start()
        routes = stream_routes(self._scenario, self.run.plan_at_start)
        folder = self._folder.path
        self.run.has_routes = lambda: (
            not mesh_interfaces.missing_routes(
                self.plan, self._engine.namespace_fds, lambda node, name: self.processes.get(node, name).pid, routes
            )
        )
        self.processes.on_exit = self.run.process_ended
        self.processes.on_lost = lambda: self._fail("the lab's fork server ended; no process is watched any more")
        text = "127.0.0.1 localhost\n::1 localhost\n" + "".join(f"{a} {n}\n" for a, n in hosts(self.plan))
        keep = keep_paths(sys.prefix, sys.base_prefix, self._folder.path, *self._options.keep_visible)
        for node in self.plan.nodes:
            self.processes.add_node(node, self._engine.namespace_fds[node], text, keep)
        await wait_ready([self.processes.start(spec) for spec in mesh_processes(self.plan, folder)], READY_LIMIT_S)
        mesh_interfaces.wait_for_processes(self.plan, self._engine.namespace_fds)
        self.run.specs_of = lambda node: node_processes(self._scenario, node, folder, self.plan)
        self.run.on_start = self.motion.begin
        self.run.forestall = self.motion.forestall
        self.motion.held_ns = lambda: round(self.run.motion_standstill.total_s(self.run.t_s or 0.0) * 1e9)
        self.motion.on_failure = self._fail
        self.run.in_contact = lambda a, b: self.motion.in_contact(a, b)
        self.run.contacts = self.motion.contacts
        specs = [spec for node in self._scenario.at_rest for spec in self.run.specs_of(node)]
        await wait_ready([self.processes.start(spec) for spec in specs], READY_LIMIT_S, self.tell)
        self.acts = Acts(self)
        self._control = ControlServer(self._folder.control_socket, Requests(self, self.acts).handle)

    def _plan_at_start(self) -> LabPlan:
        """Put the radios whose strengths change on the air; returns the plan of who hears whom then."""
        radio = self._scenario.radio
        if radio is None or not radio.propagation.changes_with_time:
            return self.plan
        from netlab.lab.waves import let_radios_follow  # NumPy, which all other labs do without

        return let_radios_follow(self._scenario, self.plan, self.links, self.motion, self.recording)

    def _start_recording(self) -> Recording:
        if self._options.capture is None:
            return Recording(None)
        streams = self._scenario.streams()
        traffic = self._scenario.traffic
        metadata = run_metadata(
            scenario_text=self._options.scenario_text,
            overrides=self._options.overrides,
            engine=self._engine_name,
            clock=clock_here(),
            duration_s=self._scenario.duration_s,
            plan=self.plan,
            streams=streams,
            kept_latest=[stream.index for stream in streams if traffic[stream.entry].offline == "latest"],
        )
        attachments = {LAYOUT_NAME: layout_file(metadata)}
        recording = Recording.start(self._options.capture, metadata, attachments, len(self.plan.nodes))
        if self._options.packets:
            for node in self.plan.nodes:
                interfaces = [port.ifname for port in self.plan.ports if port.node == node]
                interfaces += [mesh.ifname for mesh in self.plan.meshes if mesh.node == node]
                recording.add_node(node, self._engine.namespace_fds[node], interfaces)
            verdicts = recording.add_verdicts()
            if verdicts is not None:
                self._engine.record_verdicts(verdicts)
                os.close(verdicts)
            recording.links(self.links.describe(counters=True))
        recording.sync()
        return recording

    # -- serving --------------------------------------------------------------------------------------------------

    async def serve(self) -> None:
        """Return when the lab is to end; everything is stopped then."""
        while not self._ending.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._ending.wait(), 0.5)
            self._notices += self.recording.notices()
            if not self._failures and (problem := self._engine.problem()) is not None:
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
        self.motion.end()
        for process in self.processes.all():
            self.processes.stop(process)
        self._close_recording()
        self._engine.close()

    def status(self) -> dict[str, Any]:
        """The lab as plain values, for commands."""
        return {
            "name": self._folder.name,
            "scenario": self._scenario.name,
            "seed": self.plan.seed,
            "engine": self._engine_name,
            "phase": self.run.phase,
            "t_s": self.run.t_s,
            "t0_ns": self.run.t0_ns,
            "duration_s": self._scenario.duration_s,
            "end_s": self.run.end_s,
            "held": self.run.schedule.is_held,
            "coming": self.run.coming(),
            "bring_up_s": self._bring_up_s,
            "nodes": list(self.plan.nodes),
            "processes": [process.describe() for process in self.processes.all()],
            "links": [{key: row[key] for key in ("from", "to", "state")} for row in self.links.describe()],
            "streams": self.run.streams,
            "problems": self.run.problems,
            "notices": self._notices,
            "failures": self._failures,
            "worst_stall_s": self._stalls.worst_s,
            "medium": self._engine.timing(),
            "capture": str(self._options.capture) if self._options.capture else None,
            "recording": self.recording.file,
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
        self._used = [{**process.identity(), **asdict(process.usage())} for process in self.processes.all()]
        self._close_recording()
        self.run.finish()

    def _close_recording(self) -> None:
        self._notices += self.recording.notices()
        if self.recording.active:
            try:
                self.recording.links(self.links.describe(counters=True))
            except MachineError as error:
                self._notices.append(str(error))
        stats = self.recording.close()
        if stats is not None:
            self._recorder_stats = asdict(stats)


def _node_environment() -> dict[str, str]:
    """The user's environment, with this installation's programs first and without the host's runtime directory."""
    env = {key: value for key, value in os.environ.items() if key not in _NOT_FOR_NODES}
    env["PATH"] = f"{Path(sys.executable).parent}:{env.get('PATH', '/usr/bin:/bin')}:/usr/sbin:/sbin"
    return env


def _reap_orphans() -> None:
    """PID 1 inherits what daemons leave behind."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _say(ready_fd: int, answer: dict[str, Any]) -> None:
    _write(ready_fd, answer)
    os.close(ready_fd)


def _write(ready_fd: int, told: dict[str, Any]) -> None:
    os.write(ready_fd, json.dumps(told).encode() + b"\n")


async def _main(folder: LabFolder, ready_fd: int) -> int:
    scenario, options = pickle.loads((folder.path / "scenario.pickle").read_bytes())
    try:
        supervisor = Supervisor(folder, scenario, options)
        supervisor.tell = lambda what: _write(ready_fd, {"stage": what})
        await supervisor.build()
    except NetlabError as error:
        _say(ready_fd, {"error": str(error), "kind": "machine" if isinstance(error, MachineError) else "lab"})
        return 1
    _say(ready_fd, {"ok": True})
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
    folder = LabFolder(options.folder)

    # Two descriptors per node and more per process: the usual soft limit of 1024 ends at some hundred nodes.
    _soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))

    def in_box() -> int:
        return asyncio.run(_main(folder, options.ready_fd))

    try:
        return run_in_box(in_box, lifeline_fd=options.lifeline_fd)
    except NetlabError as error:
        _say(options.ready_fd, {"error": str(error), "kind": "machine"})
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
