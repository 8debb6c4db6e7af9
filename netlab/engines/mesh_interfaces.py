"""The mesh interfaces of a plan, on top of the ports that an engine made; the same for every engine.

Those that the kernel makes are made here. A mesh that a process of the node makes needs nothing here: its process
opens the tap, and the members are the ports without address.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

from netlab.engines.base import LabPlan
from netlab.errors import MachineError
from netlab.kernel import batman
from netlab.kernel.probe import in_child, try_batman
from netlab.medium.meshes import MeshKind

_WAY_OUT = (
    "load it (sudo modprobe batman-adv), or run the scenario in a kernel that has it: netlab run FILE --in vm "
    "(once before: netlab vm build)"
)


def check_kernel(plan: LabPlan) -> None:
    """Refuse a plan whose meshes this kernel cannot make; to be asked before anything is built.

    Raises:
        MachineError: Names the module and the way out.
    """
    if any(mesh.kind is MeshKind.BATMAN_ADV for mesh in plan.meshes) and (reason := in_child(try_batman)):
        raise MachineError(f"mesh: batman-adv needs the kernel module batman-adv ({reason}); {_WAY_OUT}")


def bring_up(plan: LabPlan, namespace_fds: Mapping[str, int]) -> float:
    """Make every mesh interface that the kernel makes, members in it, addressed and up.

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
        if not mesh.kind.made_by_kernel:
            continue
        members = [plan.ports[port].ifname for port in mesh.ports]
        try:
            batman.create(namespace_fds[mesh.node], mesh.ifname, mesh.mac, mesh.address, members, mesh.batman)
        except OSError as error:
            raise MachineError(f"node {mesh.node}: {error}") from error
    return time.perf_counter() - started


def missing_routes(
    plan: LabPlan, namespace_fds: Mapping[str, int], wanted: Iterable[tuple[str, str]]
) -> set[tuple[str, str]]:
    """Return those of ``wanted``, pairs (node, other node of its mesh), for which the node has no route yet.

    Only where the kernel is the mesh; a mesh that is a process makes its nodes' daemons wait by itself.
    """
    meshes = {mesh.node: mesh for mesh in plan.meshes if mesh.kind.made_by_kernel}
    pairs = [(node, other) for node, other in wanted if node in meshes and other in meshes]
    known = {node: batman.routed(namespace_fds[node]) for node in {node for node, _ in pairs}}
    return {(node, other) for node, other in pairs if meshes[other].mac not in known[node]}
