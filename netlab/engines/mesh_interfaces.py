"""The mesh interfaces of a plan, on top of the ports that an engine made; the same for every engine.

Where the kernel is the mesh, its interface is made here with its members in it. Where a process of the node is, the
interface is a tap, which is made here too, so that the recorder and the other processes find it: :func:`processes`
tells what takes its other end.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from netlab.engines.base import LabPlan
from netlab.errors import MachineError
from netlab.kernel import batman, taps, tun
from netlab.kernel.probe import in_child, try_batman, try_tun
from netlab.medium.meshes import MeshInterface, MeshKind
from netlab.medium.segments import SegmentKind

_IN_BOX = "in a kernel that has it: netlab run FILE --in vm (once before: netlab vm build)"
_WAY_OUT = f"load it (sudo modprobe batman-adv), or run the scenario {_IN_BOX}"


def check_kernel(plan: LabPlan) -> None:
    """Refuse a plan whose meshes this kernel cannot make; to be asked before anything is built.

    Raises:
        MachineError: Names the module and the way out.
    """
    kinds = {mesh.kind for mesh in plan.meshes}
    if MeshKind.BATMAN_ADV in kinds and (reason := in_child(try_batman)):
        raise MachineError(f"mesh: batman-adv needs the kernel module batman-adv ({reason}); {_WAY_OUT}")
    if MeshKind.FLOOD in kinds and (reason := in_child(try_tun)):
        raise MachineError(f"mesh: flood needs {tun.DEVICE} ({reason}); {tun.REMEDY}, or run it {_IN_BOX}")


def bring_up(plan: LabPlan, namespace_fds: Mapping[str, int]) -> float:
    """Make every mesh interface, addressed and up; those that are the kernel's with their members in them.

    Args:
        plan: Its ports exist and are up.
        namespace_fds: Network namespace of every node.

    Returns:
        Seconds that it took.

    Raises:
        MachineError: The kernel refuses one; names the node.
    """
    started = time.perf_counter()
    for mesh in plan.meshes:
        namespace_fd = namespace_fds[mesh.node]
        members = [plan.ports[port].ifname for port in mesh.ports]
        try:
            if mesh.kind.made_by_kernel:
                batman.create(namespace_fd, mesh.ifname, mesh.mac, mesh.address, members, mesh.batman)
            else:
                taps.create(namespace_fd, mesh.ifname, mesh.mac, mesh.address, mesh.mtu)
        except OSError as error:
            raise MachineError(f"node {mesh.node}: {error}") from error
    return time.perf_counter() - started


@dataclass(frozen=True, slots=True)
class MeshProcess:
    """A process that is the mesh of a node; it may be started as soon as the interfaces are up."""

    node: str
    name: str
    argv: tuple[str, ...]


def processes(plan: LabPlan) -> list[MeshProcess]:
    """Return the processes that are meshes; nothing works over those before they are ready."""
    radios = {port for segment in plan.segments if segment.kind is SegmentKind.RADIO for port in segment.ports}
    return [
        MeshProcess(mesh.node, mesh.kind.process, _flood_argv(plan, mesh, radios))
        for mesh in plan.meshes
        if mesh.kind.process is not None
    ]


def wait_for_processes(plan: LabPlan, namespace_fds: Mapping[str, int]) -> None:
    """Return when all interfaces whose mesh is a process pass frames on; the processes have reported ready.

    Raises:
        MachineError: One does not; names the node.
    """
    for mesh in plan.meshes:
        if mesh.kind.process is not None:
            try:
                taps.wait_until_running(namespace_fds[mesh.node], mesh.ifname)
            except OSError as error:
                raise MachineError(f"node {mesh.node}: {error}") from error


def _flood_argv(plan: LabPlan, mesh: MeshInterface, radios: set[int]) -> tuple[str, ...]:
    argv = ["netlab-flood", "--interface", mesh.ifname]
    for port in mesh.ports:
        argv += ["--radio" if port in radios else "--wire", plan.ports[port].ifname]
    argv += ["--hop-limit", str(mesh.flood.hop_limit), "--jitter", str(mesh.flood.jitter_s)]
    argv += ["--seed", f"{plan.seed}/{mesh.node}/flood", "--ready-fd", "{ready_fd}", "--events-fd", "{events_fd}"]
    return tuple(argv)


def missing_routes(
    plan: LabPlan, namespace_fds: Mapping[str, int], wanted: Iterable[tuple[str, str]]
) -> set[tuple[str, str]]:
    """Return those of ``wanted``, pairs (node, other node of its mesh), for which the node has no route yet.

    Only where the kernel is the mesh: a flood has no routes.
    """
    meshes = {mesh.node: mesh for mesh in plan.meshes if mesh.kind.made_by_kernel}
    pairs = [(node, other) for node, other in wanted if node in meshes and other in meshes]
    known = {node: batman.routed(namespace_fds[node]) for node in {node for node, _ in pairs}}
    return {(node, other) for node, other in pairs if meshes[other].mac not in known[node]}
