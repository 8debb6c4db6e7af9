"""What to run in each node of a scenario: daemons with their configuration, the user's own programs, traffic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomli_w
import yaml

from netlab.engines import mesh_interfaces
from netlab.engines.base import LabPlan
from netlab.engines.plan import compile_plan, hosts
from netlab.lab.process import ProcessSpec, Restart
from netlab.lab.resolution import SPREAD_S
from netlab.lab.traffic import StreamSpec, encode_streams
from netlab.medium.segments import WifiMode
from netlab.scenario.model import Scenario
from netlab.scenario.traffic import ALL

DISCOVERY_LIMIT_S = 10.0
SOURCE = "traffic-source"
SINK = "traffic-sink"


def node_processes(scenario: Scenario, node: str, folder: Path, plan: LabPlan | None = None) -> list[ProcessSpec]:
    """The scenario's own processes of a node; writes the configuration that they need below ``folder``."""
    specs = []
    for process in scenario.nodes[node].processes:
        argv: tuple[str, ...]
        if process.builtin == "udp_mesh":
            config = folder / f"{node}.udp_mesh.toml"
            store = {"store": str(folder / f"{node}.udp_mesh.db")}
            config.touch(mode=0o600)  # it may hold the team's key
            config.write_text(tomli_w.dumps(daemon_config(scenario, node, plan) | store))
            argv = ("udp-mesh-daemon", "--config", str(config))
            argv += ("--ready-fd", "{ready_fd}", "--events-fd", "{events_fd}", "--seed", f"{scenario.seed}/{node}")
        elif process.builtin == "rose":
            argv = ("rose", "run", str(_rose_file(scenario, node, folder, plan)), "--ready-fd", "{ready_fd}")
        else:
            assert process.argv is not None  # the model: builtin or argv
            argv = process.argv
        specs.append(
            ProcessSpec(
                node=node,
                name=process.name,
                argv=argv,
                env=mesh_environment(scenario, node) | process.env,
                waits_for_ready=process.ready == "fd",
                restart=Restart(process.restart),
            )
        )
    return specs


def _rose_file(scenario: Scenario, node: str, folder: Path, plan: LabPlan | None) -> Path:
    """Write the file of a node's Service Manager, with the addresses that its services have in this lab."""
    addresses: dict[str, str] = {}
    for address, name in hosts(plan or compile_plan(scenario)):
        addresses.setdefault(name, address)
    file = folder / f"{node}.rose.yaml"
    file.touch(mode=0o600)  # it may hold keys
    file.write_text(yaml.safe_dump(scenario.rose_file(node, addresses), sort_keys=False))
    return file


def mesh_processes(plan: LabPlan, folder: Path) -> list[ProcessSpec]:
    """The processes that are nodes' meshes, to be ready before anything else; their files go below ``folder``."""
    return [
        ProcessSpec(node=process.node, name=process.name, argv=process.argv, waits_for_ready=process.says_ready)
        for process in mesh_interfaces.processes(plan, folder)
    ]


def mesh_environment(scenario: Scenario, node: str) -> dict[str, str]:
    """What tells a node's programs which interface to use: ``NETLAB_MESH_INTERFACE``, only where a mesh has one."""
    mesh = scenario.meshes[node]
    return {} if mesh is None or mesh.routes_ip else {"NETLAB_MESH_INTERFACE": mesh.ifname}


def daemon_config(scenario: Scenario, node: str, plan: LabPlan | None = None) -> dict[str, Any]:
    """The udp_mesh daemon's configuration in one node: the scenario's settings and the topics that it publishes.

    ``plan``: where nodes have their addresses, the scenario's own if None.
    """
    settings = scenario.mesh_settings(node)
    mesh = scenario.meshes[node]
    if mesh is not None and mesh.routes_ip:  # no broadcast finds anybody over hops
        settings.setdefault("neighbours", [name for name in scenario.nodes if scenario.nodes[name].process("udp_mesh")])
    if "neighbours" in settings:
        settings["neighbours"] = neighbour_addresses(plan or compile_plan(scenario), node, settings["neighbours"])
    topics: dict[str, dict[str, Any]] = {}
    for entry in (entry for entry in scenario.traffic if entry.from_ == node):
        topic: dict[str, Any] = {
            "priority": entry.priority,
            "reliability": entry.reliability,
            "keep": entry.keep,
            "offline": entry.offline,
            "redundancy": entry.redundancy,
        }
        if entry.lifetime_s is not None:
            topic["lifetime_s"] = entry.lifetime_s
        if entry.compress:
            topic["compress"] = True
        topics[entry.topic] = topic | (entry.rate_limit or {})
    for name, given in settings.pop("topics", {}).items():
        topics[name] = topics.get(name, {}) | given
    interfaces = {} if mesh is None or mesh.routes_ip else {"interfaces": [mesh.ifname]}
    return {"name": node, **interfaces, **settings, "topics": topics}


def streams(scenario: Scenario) -> list[StreamSpec]:
    """The scenario's streams, numbered as in ``Scenario.streams``."""
    first: dict[int, int] = {}
    for stream in scenario.streams():
        first.setdefault(stream.entry, stream.index)
    return [
        StreamSpec(
            stream=stream.index,
            publication=first[stream.entry] if ALL in scenario.traffic[stream.entry].to else stream.index,
            to_all=ALL in scenario.traffic[stream.entry].to,
            source=stream.source,
            destination=stream.destination,
            topic=stream.topic,
            size_bytes=scenario.traffic[stream.entry].size_bytes,
            interval_s=1.0 / scenario.traffic[stream.entry].rate_hz,
        )
        for stream in scenario.streams()
    ]


def traffic_sinks(scenario: Scenario) -> list[ProcessSpec]:
    """One sink process per node that receives."""
    by_node: dict[str, list[StreamSpec]] = {}
    for stream in streams(scenario):
        by_node.setdefault(stream.destination, []).append(stream)
    return [_traffic(node, SINK, own, []) for node, own in by_node.items()]


def traffic_sources(scenario: Scenario, plan: LabPlan) -> list[ProcessSpec]:
    """One source process per node that publishes; each waits for the destinations that its radios and wires reach."""
    by_node: dict[str, list[StreamSpec]] = {}
    for stream in streams(scenario):
        by_node.setdefault(stream.source, []).append(stream)
    shares_a_channel = any(segment.channel is not None for segment in plan.segments)
    loses = any(impairment.loss is not None for segment in plan.segments for impairment in segment.pairs.values())
    specs = []
    for node, own in by_node.items():
        # A destination may be out of reach when a carried source comes to life, which then waits for nobody.
        reachable = (
            set()
            if scenario.nodes[node].carried_by is not None
            else reach(scenario, plan, node) & {stream.destination for stream in own}
        )
        extra = ["--seed", str(plan.seed), "--discovery-s", str(DISCOVERY_LIMIT_S)]
        extra += ["--await-peers", ",".join(sorted(reachable))]
        if shares_a_channel or loses:
            extra += ["--resolve-spread-s", str(SPREAD_S if shares_a_channel else 0.0)]
        specs.append(_traffic(node, SOURCE, own, extra))
    return specs


def reach(scenario: Scenario, plan: LabPlan, node: str) -> set[str]:
    """Nodes that ``node`` can discover at the start: its neighbours, or in a mesh all that hops lead to."""
    kind = scenario.meshes[node]
    at_rest = set(scenario.at_rest)
    if node not in at_rest:
        return set()
    if kind is None:
        direct = neighbours(plan, node) & at_rest
        return direct | (_over_radio_mesh(plan, node) | _over_bridges(scenario, plan, node, direct)) & at_rest
    found, new = {node}, {node}
    while new:
        new = {name for known in new for name in neighbours(plan, known) if scenario.meshes[name] is kind}
        new = (new & at_rest) - found
        found |= new
    return found - {node}


def _over_bridges(scenario: Scenario, plan: LabPlan, node: str, direct: set[str]) -> set[str]:
    """Nodes on the other segments of those bridges that are among the neighbours of ``node``."""
    bridges = direct & set(scenario.bridge_nodes)
    found = {other for x in bridges for other in neighbours(plan, x) if scenario.bridges(x, node, other)}
    return found - {node}


def _over_radio_mesh(plan: LabPlan, node: str) -> set[str]:
    """Nodes to which the path selection of 802.11s finds a way from the radio of ``node``."""
    found: set[str] = set()
    for segment in plan.segments:
        if segment.wifi is not None and segment.wifi.mode is WifiMode.MESH:
            reached = {port for port in segment.ports if plan.ports[port].node == node}
            new = set(reached)
            while new:
                new = {b for a, b in segment.pairs if a in new and (b, a) in segment.pairs} - reached
                reached |= new
            found |= {plan.ports[port].node for port in reached}
    return found - {node}


def stream_routes(scenario: Scenario, plan: LabPlan) -> set[tuple[str, str]]:
    """The pairs (node, end of a stream) for which a mesh needs a route, as far as hops lead at the start.

    Each end is wanted by every node in its reach: a relay that does not know it throws away what it should pass on.
    """
    ends = {(s.source, s.destination) for s in scenario.streams() if scenario.meshes[s.source] is not None}
    within = {source: reach(scenario, plan, source) for source, _ in ends}
    met = {end for a, b in ends if b in within[a] for end in (a, b)}
    return {(node, end) for end in met for node in reach(scenario, plan, end)}


def neighbours(plan: LabPlan, node: str) -> set[str]:
    """Nodes that share a segment with ``node`` and are in range in both directions."""
    found = set()
    for segment in plan.segments:
        for sender, receiver in segment.pairs:
            if plan.ports[sender].node == node and (receiver, sender) in segment.pairs:
                found.add(plan.ports[receiver].node)
    return found


def neighbour_addresses(plan: LabPlan, node: str, names: Sequence[str]) -> list[str]:
    """IPv4 addresses of the named nodes, on every link, radio and mesh that they share with ``node``, in range or not.

    The node itself is left out, so that one list may stand for all.
    """
    found = []
    mine = {interface.kind for interface in plan.meshes if interface.node == node}
    if mine:
        found = [m.address for m in plan.meshes if m.node in names and m.node != node and m.kind in mine]
    for segment in () if mine else plan.segments:
        if node in {plan.ports[index].node for index in segment.ports}:
            ports = [plan.ports[index] for index in segment.ports]
            found += [p.address for p in ports if p.node in names and p.node != node and p.address is not None]
    return [address.partition("/")[0] for address in found]


def _traffic(node: str, name: str, own: list[StreamSpec], extra: list[str]) -> ProcessSpec:
    argv = [f"netlab-{name}", "--streams", encode_streams(own), "--ready-fd", "{ready_fd}"]
    argv += ["--events-fd", "{events_fd}", "--command-fd", "{command_fd}", *extra]
    return ProcessSpec(node=node, name=name, argv=tuple(argv), waits_for_ready=True)
