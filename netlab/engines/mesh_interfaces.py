"""The mesh interfaces of a plan, on top of the ports that an engine made; the same for every engine.

Where the kernel is the mesh, its interface is made here with its members in it. Where a process of the node is, the
interface is a tap (for wnet a veth where there are none), which is made here too, so that the recorder and the other
processes find it: :func:`processes` tells what takes its other end. Babel has none: members get its node's address.
"""

from __future__ import annotations

import contextlib
import ipaddress
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import tomli_w

from netlab.engines.base import LabPlan
from netlab.errors import MachineError
from netlab.kernel import babel, batman, taps, tun
from netlab.kernel.probe import in_child, try_batman, try_tun
from netlab.medium.meshes import MeshInterface, MeshKind
from netlab.medium.segments import Port, SegmentKind
from wnet.io.control import ControlError, ask

#: Where the wnet daemon of a node answers, in the node's own view of files: its programs find it there.
WNET_SOCKET = "/run/wnet.sock"
_IN_BOX = "in a kernel that has it: netlab run FILE --in vm (once before: netlab vm build)"
_WAY_OUT = f"load it (sudo modprobe batman-adv), or run the scenario {_IN_BOX}"


def check_kernel(plan: LabPlan) -> None:
    """Refuse a plan whose meshes this machine cannot make; to be asked before anything is built.

    Raises:
        MachineError: Names what is missing and the way out.
    """
    kinds = {mesh.kind for mesh in plan.meshes}
    if MeshKind.BATMAN_ADV in kinds and (reason := in_child(try_batman)):
        raise MachineError(f"mesh: batman-adv needs the kernel module batman-adv ({reason}); {_WAY_OUT}")
    if MeshKind.FLOOD in kinds and (reason := in_child(try_tun)):
        raise MachineError(f"mesh: flood needs {tun.DEVICE} ({reason}); {tun.REMEDY}, or run it {_IN_BOX}")
    if MeshKind.BABEL in kinds and babel.program() is None:
        raise MachineError("mesh: babel needs the program babeld; install it: sudo apt-get install babeld")


def fitted(plan: LabPlan) -> LabPlan:
    """The plan as this machine can build it: radios that the lab plays are in monitor mode only with TAPs."""
    played = {port for segment in plan.segments if segment.channel is not None for port in segment.ports}
    if not any(port.radiotap for port in plan.ports if port.index in played) or in_child(try_tun) is None:
        return plan
    ports = (replace(port, radiotap=False) if port.index in played else port for port in plan.ports)
    return replace(plan, ports=tuple(ports))


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
    has_taps = any(mesh.kind is MeshKind.WNET for mesh in plan.meshes) and in_child(try_tun) is None
    for mesh in plan.meshes:
        members = [plan.ports[port] for port in mesh.ports]
        try:
            _make(mesh, members, namespace_fds[mesh.node], has_taps=has_taps)
        except OSError as error:
            raise MachineError(f"node {mesh.node}: {error}") from error
    return time.perf_counter() - started


def _make(mesh: MeshInterface, members: Sequence[Port], namespace_fd: int, *, has_taps: bool) -> None:
    names = [port.ifname for port in members]
    match mesh.kind:
        case MeshKind.BATMAN_ADV:
            batman.create(namespace_fd, mesh.ifname, mesh.mac, mesh.address, names, mesh.batman)
        case MeshKind.BABEL:
            babel.create(namespace_fd, mesh.address, {port.ifname: port.mac for port in members})
        case MeshKind.WNET if not has_taps:
            taps.create_veth(namespace_fd, mesh.ifname, mesh.mac, mesh.address, mesh.mtu)
        case _:
            taps.create(namespace_fd, mesh.ifname, mesh.mac, mesh.address, mesh.mtu)


@dataclass(frozen=True, slots=True)
class MeshProcess:
    """A process that is the mesh of a node; it may be started as soon as the interfaces are up."""

    node: str
    name: str
    argv: tuple[str, ...]
    says_ready: bool = True


def processes(plan: LabPlan, folder: Path) -> list[MeshProcess]:
    """Return the processes that are meshes; nothing works over those before they are ready.

    Their files, where they need one, are written below ``folder``.
    """
    radios = {port for segment in plan.segments if segment.kind is SegmentKind.RADIO for port in segment.ports}
    return [_process(plan, mesh, radios, folder) for mesh in plan.meshes if mesh.kind.process is not None]


def _process(plan: LabPlan, mesh: MeshInterface, radios: set[int], folder: Path) -> MeshProcess:
    name = mesh.kind.process or ""
    members = [plan.ports[port] for port in mesh.ports]
    match mesh.kind:
        case MeshKind.BABEL:
            return MeshProcess(mesh.node, name, babel.argv([port.ifname for port in members], mesh.babel), False)
        case MeshKind.WNET:
            argv = _wnet_argv(plan, mesh, [(port, port.index in radios) for port in members], folder)
            return MeshProcess(mesh.node, name, argv)
        case _:
            return MeshProcess(mesh.node, name, _flood_argv(plan, mesh, radios))


def wait_for_processes(plan: LabPlan, namespace_fds: Mapping[str, int]) -> None:
    """Return when all interfaces whose mesh is a process pass frames on; the processes have reported ready.

    Raises:
        MachineError: One does not; names the node.
    """
    for mesh in plan.meshes:
        if mesh.kind.process is not None and not mesh.kind.routes_ip:
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


def _wnet_argv(
    plan: LabPlan, mesh: MeshInterface, members: Sequence[tuple[Port, bool]], folder: Path
) -> tuple[str, ...]:
    config = folder / f"{mesh.node}.wnet.toml"
    config.touch(mode=0o600)  # it may hold the team's key
    rates_bps = _rates_bps(plan)
    table = {
        "interface": mesh.ifname,
        "members": [_member(port, is_radio, rates_bps) for port, is_radio in members],
        "mesh": dict(mesh.wnet),
    }
    config.write_text(tomli_w.dumps(table | {"socket": WNET_SOCKET}))
    argv = ("wnet-daemon", "--config", str(config), "--ready-fd", "{ready_fd}", "--events-fd", "{events_fd}")
    return (*argv, "--seed", f"{plan.seed}/{mesh.node}/wnet")


def _member(port: Port, is_radio: bool, rates_bps: Mapping[int, tuple[int, ...]]) -> dict[str, object]:
    words: dict[str, object] = {"interface": port.ifname, "radio": is_radio}
    if port.radiotap:
        words |= {"mac": port.mac.hex(":")} | (
            {"rates_bps": list(rates_bps[port.index])} if port.index in rates_bps else {}
        )
    return words


def _rates_bps(plan: LabPlan) -> dict[int, tuple[int, ...]]:
    """What the ports in monitor mode can send at, rising."""
    found: dict[int, tuple[int, ...]] = {}
    for segment in plan.segments:
        if segment.channel is not None:
            from netlab.medium.phy import PHYS  # tables that a lab of wires does without

            rates_bps = tuple(sorted({round(rate.bps) for rate in PHYS[segment.channel.phy].rates}))
            found |= dict.fromkeys(segment.ports, rates_bps)
    return found


def missing_routes(
    plan: LabPlan,
    namespace_fds: Mapping[str, int],
    pid_of: Callable[[str, str], int],
    wanted: Iterable[tuple[str, str]],
) -> set[tuple[str, str]]:
    """Return those of ``wanted``, pairs (node, other node of its mesh), for which the node has no route yet.

    A flood has no routes and is never missing one. ``pid_of`` gives the process of a node by its name.
    """
    meshes = {mesh.node: mesh for mesh in plan.meshes if mesh.kind is not MeshKind.FLOOD}
    pairs = [(node, other) for node, other in wanted if node in meshes and other in meshes]
    known = {node: _routed(meshes[node], namespace_fds[node], pid_of) for node in {node for node, _ in pairs}}
    return {(node, other) for node, other in pairs if _name_in_routes(meshes[other]) not in known[node]}


def _routed(mesh: MeshInterface, namespace_fd: int, pid_of: Callable[[str, str], int]) -> set[bytes]:
    """What a node has routes to, as :func:`_name_in_routes` names it."""
    match mesh.kind:
        case MeshKind.BABEL:
            return babel.routed(namespace_fd)
        case MeshKind.WNET:
            with contextlib.suppress(ControlError):
                root = Path("/proc") / str(pid_of(mesh.node, mesh.kind)) / "root"  # /run is the node's own
                routes = ask(f"{root}{WNET_SOCKET}", "routes")["routes"]
                return {bytes.fromhex(route["destination"].replace(":", "")) for route in routes}
            return set()
        case _:
            return batman.routed(namespace_fd)


def _name_in_routes(mesh: MeshInterface) -> bytes:
    return ipaddress.IPv4Interface(mesh.address).ip.packed if mesh.kind.routes_ip else mesh.mac
