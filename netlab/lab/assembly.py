"""Brings a lab up, part by part and in order: network, recorder, motion, run, meshes, nodes' processes."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from netlab.capture.layout import LAYOUT_NAME, layout_file
from netlab.capture.metadata import run_metadata
from netlab.clock import begin_in_step, clock_here
from netlab.engines import mesh_interfaces
from netlab.engines.base import Engine, LabPlan
from netlab.engines.choose import make_engine
from netlab.engines.plan import compile_plan, hosts
from netlab.ipc import Channel, start_module
from netlab.lab.isolation import keep_paths
from netlab.lab.launch import LaunchOptions
from netlab.lab.links import Links
from netlab.lab.motion import set_in_motion
from netlab.lab.parts import Parts
from netlab.lab.processes import Processes
from netlab.lab.programs import mesh_processes, node_processes, stream_routes
from netlab.lab.readiness import READY_LIMIT_S, wait_ready
from netlab.lab.recording import Recording
from netlab.lab.registry import LabFolder
from netlab.lab.scenario_run import ScenarioRun
from netlab.medium.impairments import Impairment
from netlab.scenario.model import Scenario
from netlab.timeline import SetPairs, compile_timeline

_NOT_FOR_NODES = ("XDG_RUNTIME_DIR", "UDP_MESH_SOCKET", "WNET_SOCKET")


@dataclass(frozen=True, slots=True)
class Network:
    """The namespaces and interfaces of a lab, before anything runs in them."""

    scenario: Scenario
    plan: LabPlan
    engine_name: str
    engine: Engine
    spawner: Channel
    bring_up_s: float


def bring_up_network(scenario: Scenario, engine: str, tell: Callable[[str], None] = lambda what: None) -> Network:
    """Bring up every namespace and interface, and the fork server for what will run there.

    Args:
        scenario: What to bring up.
        engine: Name of the engine, or ``auto``.
        tell: Hears what is being done.

    Raises:
        MachineError: This machine cannot run it; the text names the way out.
        LabError: An interface could not be made.
    """
    plan = mesh_interfaces.fitted(compile_plan(scenario))
    mesh_interfaces.check_kernel(plan)
    name, made = make_engine(engine, plan, _later_impairments(scenario, plan))
    spawner, _pid = start_module("netlab.lab.spawner")
    begin_in_step()
    tell(f"connecting {len(plan.nodes)} nodes")
    bring_up_s = made.bring_up()
    bring_up_s += mesh_interfaces.bring_up(plan, made.namespace_fds)
    return Network(scenario, plan, name, made, spawner, bring_up_s)


def make_parts(network: Network, options: LaunchOptions, folder: LabFolder) -> Parts:
    """Start the recorder, have the nodes ready for processes, put everybody where it begins. Raises CaptureError."""
    scenario, plan, fds = network.scenario, network.plan, network.engine.namespace_fds
    links = Links(plan, network.engine)
    recording = _start_recording(network, options, links)
    recording.journal = folder.journal
    processes = Processes(network.spawner, folder.logs, _node_environment(), str(Path.cwd()))
    processes.open_events = recording.open_events
    processes.on_line = recording.line
    text = "127.0.0.1 localhost\n::1 localhost\n" + "".join(f"{a} {n}\n" for a, n in hosts(plan))
    keep = keep_paths(sys.prefix, sys.base_prefix, folder.path, *options.keep_visible)
    for node in plan.nodes:
        processes.add_node(node, fds[node], text, keep)
    motion = set_in_motion(scenario, plan, links, recording)
    return Parts(scenario, plan, links, processes, recording, motion)


def make_run(network: Network, parts: Parts, folder: Path) -> ScenarioRun:
    """Put the radios on the air; returns the scenario's run, to which all that ends belongs from now on."""
    scenario, plan, processes = parts.scenario, parts.plan, parts.processes
    plan_at_start = _plan_at_start(parts)
    routes = stream_routes(scenario, plan_at_start)

    def has_routes() -> bool:
        fds = network.engine.namespace_fds
        return not mesh_interfaces.missing_routes(plan, fds, lambda node, name: processes.get(node, name).pid, routes)

    run = ScenarioRun(
        parts,
        plan_at_start=plan_at_start,
        specs_of=lambda node: node_processes(scenario, node, folder, plan),
        has_routes=has_routes,
    )
    processes.on_exit = run.process_ended
    return run


async def start_processes(network: Network, parts: Parts, folder: Path, tell: Callable[[str], None]) -> None:
    """Start the meshes, then the processes of all nodes that nobody carries; returns when they are ready.

    Raises:
        LabError: One ended first, or was not ready in time; with its argv, exit code and last log lines.
    """
    scenario, plan, start = parts.scenario, parts.plan, parts.processes.start
    await wait_ready([start(spec) for spec in mesh_processes(plan, folder)], READY_LIMIT_S)
    mesh_interfaces.wait_for_processes(plan, network.engine.namespace_fds)
    specs = [spec for node in scenario.at_rest for spec in node_processes(scenario, node, folder, plan)]
    await wait_ready([start(spec) for spec in specs], READY_LIMIT_S, tell)


def _later_impairments(scenario: Scenario, plan: LabPlan) -> list[Impairment]:
    """What the timeline will ask of the engine beside the plan."""
    return [
        change
        for entry in compile_timeline(scenario, plan)
        if isinstance(entry.action, SetPairs)
        for change in entry.action.changes.values()
        if change is not None
    ]


def _plan_at_start(parts: Parts) -> LabPlan:
    """Put the radios whose strengths change on the air; returns the plan of who hears whom then."""
    radio = parts.scenario.radio
    if radio is None or not radio.propagation.changes_with_time:
        return parts.plan
    from netlab.lab.waves import let_radios_follow  # NumPy, which all other labs do without

    return let_radios_follow(parts.scenario, parts.plan, parts.links, parts.motion, parts.recording)


def _start_recording(network: Network, options: LaunchOptions, links: Links) -> Recording:
    if options.capture is None:
        return Recording(None)
    scenario, plan, engine = network.scenario, network.plan, network.engine
    streams = scenario.streams()
    metadata = run_metadata(
        scenario_text=options.scenario_text,
        overrides=options.overrides,
        engine=network.engine_name,
        clock=clock_here(),
        duration_s=scenario.duration_s,
        plan=plan,
        streams=streams,
        kept_latest=[stream.index for stream in streams if scenario.traffic[stream.entry].offline == "latest"],
    )
    attachments = {LAYOUT_NAME: layout_file(metadata)}
    recording = Recording.start(options.capture, metadata, attachments, len(plan.nodes))
    if options.packets:
        for node in plan.nodes:
            interfaces = [port.ifname for port in plan.ports if port.node == node]
            interfaces += [mesh.ifname for mesh in plan.meshes if mesh.node == node]
            recording.add_node(node, engine.namespace_fds[node], interfaces)
        verdicts = recording.add_verdicts()
        if verdicts is not None:
            engine.record_verdicts(verdicts)
            os.close(verdicts)
        recording.links(links.describe(counters=True))
    recording.sync()
    return recording


def _node_environment() -> dict[str, str]:
    """The user's environment, with this installation's programs first and without the host's runtime directory."""
    env = {key: value for key, value in os.environ.items() if key not in _NOT_FOR_NODES}
    env["PATH"] = f"{Path(sys.executable).parent}:{env.get('PATH', '/usr/bin:/bin')}:/usr/sbin:/sbin"
    return env
