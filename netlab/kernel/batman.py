"""batman-adv's mesh interfaces: make one, enslave its members, set it up. Everything through netlink, nothing in /sys.

Settings go in while the interface has no member, so that the first routing message is sent by them. Sources:
linux/batman_adv.h; net/batman-adv/{soft-interface,netlink}.c of Linux 6.1. The routing algorithm can be given at
creation since Linux 5.11; before, it is silently the module's, so it is read back.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import sys
from collections.abc import Iterator, Mapping, Sequence

from pyroute2.netlink import nla
from pyroute2.netlink.rtnl.ifinfmsg import ifinfmsg

from netlab.kernel import genl, links, messages
from netlab.kernel import namespaces as netns
from netlab.kernel.netlink import NetlinkError, NetlinkSocket, attributes
from netlab.kernel.syscalls import CLONE_NEWNET, setns
from netlab.medium.meshes import BatmanOptions

# In every node's namespace: below the nodes' own interfaces, above what the kernel makes by itself.
_MESH_INDEX = 90

_FAMILY = "batadv"
_GET_MESH, _GET_TRANSTABLE_GLOBAL, _SET_MESH, _SET_HARDIF = 1, 7, 15, 16
_ALGO_NAME, _MESH_IFINDEX, _HARD_IFINDEX, _TT_ADDRESS, _TT_FLAGS, _FLAG_BEST = 2, 3, 6, 16, 21, 22
_TEMPORARY = 1 << 11  # BATADV_TT_CLIENT_TEMP
_BRIDGE_LOOP_AVOIDANCE, _HOP_PENALTY, _ORIG_INTERVAL, _ELP_INTERVAL = 46, 53, 57, 58


class _LinkData(nla):  # type: ignore[misc]  # pyroute2 has no types
    """IFLA_INFO_DATA of kind batadv, which pyroute2 does not know."""

    __slots__ = ()
    prefix = "IFLA_"
    nla_map = (("IFLA_BATADV_UNSPEC", "none"), ("IFLA_BATADV_ALGO_NAME", "asciiz"))


ifinfmsg.ifinfo.register_link_kind(module={"batadv": _LinkData})


def create(
    namespace_fd: int, ifname: str, mac: bytes, address: str, members: Sequence[str], options: BatmanOptions
) -> None:
    """Make a mesh interface in a node's namespace, up and addressed; the calling thread returns to its own.

    Args:
        namespace_fd: The node's network namespace.
        ifname: The mesh interface's name.
        mac: Its address, 6 bytes.
        address: IPv4 with prefix length.
        members: Names of the node's interfaces that belong to the mesh.
        options: batman-adv's settings.

    Raises:
        OSError: The kernel refuses, or has another routing algorithm than asked for; names the interface.
    """
    with _sockets(namespace_fd) as (route, generic):
        by_name = {link.ifname: link.index for link in links.list_links(route)}
        missing = [name for name in members if name not in by_name]
        if missing:
            raise OSError(f"{ifname}: there is no interface {missing[0]} to put into the mesh")
        family = _make(route, generic, ifname, mac, options)
        indices = [by_name[name] for name in members]
        _request(route, [encode_enslave(index, _MESH_INDEX) for index in indices], ifname)
        if options.elp_interval_s is not None:
            _request(generic, [set_elp_interval(family, index, options.elp_interval_s) for index in indices], ifname)
        interface = ipaddress.IPv4Interface(address)
        orders = [messages.add_address(_MESH_INDEX, interface), messages.set_up(_MESH_INDEX, up=True)]
        _request(route, orders, ifname)


def routed(namespace_fd: int) -> set[bytes]:
    """Return the addresses of other nodes' mesh interfaces to which this node has a route now.

    Broadcasts are flooded, so nodes hear each other before anything can be sent to one of them.

    Raises:
        OSError: There is no mesh interface in this namespace.
    """
    with _sockets(namespace_fd) as (_, generic):
        parts = genl.number(_MESH_IFINDEX, _MESH_INDEX)
        family = genl.family_id(generic, _FAMILY)
        answers = generic.dump(genl.message(family, _GET_TRANSTABLE_GLOBAL, parts, flags=genl.NLM_F_DUMP))
    entries = [attributes(answer, genl.ATTRIBUTES_AT) for answer in answers]
    return {entry[_TT_ADDRESS] for entry in entries if _is_route(entry)}


def _is_route(entry: Mapping[int, bytes]) -> bool:
    """Whether unicast frames arrive by an entry of the translation table (net/batman-adv/translation-table.c).

    "Best" is only who has a next hop (batadv_transtable_best_orig). An entry that was guessed from a broadcast is
    temporary: frames then carry no valid version of the table, and relays throw them away (batadv_check_unicast_ttvn).
    """
    return _FLAG_BEST in entry and not int.from_bytes(entry[_TT_FLAGS], sys.byteorder) & _TEMPORARY


def problem() -> str | None:
    """Say why this kernel makes no batman-adv interface, or None; call it in a throw-away network namespace."""
    with contextlib.closing(NetlinkSocket()) as route:
        try:
            route.request([encode_create("bat0", bytes.fromhex("020000000001"), BatmanOptions())])
        except NetlinkError as error:
            return f"no interface of kind batadv: {error.strerror}"
    return None


def _make(route: NetlinkSocket, generic: NetlinkSocket, ifname: str, mac: bytes, options: BatmanOptions) -> int:
    """Create the interface and set it; returns batman-adv's number in generic netlink, which it has from now on."""
    _request(route, [encode_create(ifname, mac, options)], ifname)
    family = genl.family_id(generic, _FAMILY)  # only now: creation may have loaded the module
    _request(generic, [set_mesh(family, options)], ifname)
    answer = generic.query(genl.message(family, _GET_MESH, genl.number(_MESH_IFINDEX, _MESH_INDEX)))
    algorithm = attributes(answer, genl.ATTRIBUTES_AT)[_ALGO_NAME].rstrip(b"\0").decode()
    if algorithm != options.routing_algorithm:
        raise OSError(
            f"{ifname} routes by {algorithm}, not {options.routing_algorithm}: this kernel takes it from "
            "/sys/module/batman_adv/parameters/routing_algo; write it there, as root, on the host"
        )
    return family


def encode_create(ifname: str, mac: bytes, options: BatmanOptions) -> bytes:
    """RTM_NEWLINK of a mesh interface, down and without members."""
    data = {"attrs": [("IFLA_BATADV_ALGO_NAME", str(options.routing_algorithm))]}
    message = ifinfmsg()
    message["index"] = _MESH_INDEX
    message["attrs"] = [
        ("IFLA_IFNAME", ifname),
        ("IFLA_ADDRESS", mac.hex(":")),
        ("IFLA_LINKINFO", {"attrs": [("IFLA_INFO_KIND", "batadv"), ("IFLA_INFO_DATA", data)]}),
    ]
    return messages.encode_message(message, messages.RTM_NEWLINK, messages.NLM_F_CREATE | messages.NLM_F_EXCL)


def encode_enslave(index: int, master: int) -> bytes:
    """RTM_NEWLINK that makes an interface a member of another."""
    message = ifinfmsg()
    message["index"] = index
    message["attrs"] = [("IFLA_MASTER", master)]
    return messages.encode_message(message, messages.RTM_NEWLINK, 0)


def set_mesh(family: int, options: BatmanOptions) -> bytes:
    """The settings of the mesh interface; what is None stays the kernel's."""
    parts = [genl.number(_MESH_IFINDEX, _MESH_INDEX), _byte(_BRIDGE_LOOP_AVOIDANCE, int(options.bridge_loop_avoidance))]
    if options.originator_interval_s is not None:
        parts.append(genl.number(_ORIG_INTERVAL, round(options.originator_interval_s * 1000)))
    if options.hop_penalty is not None:
        parts.append(_byte(_HOP_PENALTY, options.hop_penalty))
    return genl.message(family, _SET_MESH, *parts)


def set_elp_interval(family: int, index: int, interval_s: float) -> bytes:
    """The time between link probes on one member."""
    ends = (genl.number(_MESH_IFINDEX, _MESH_INDEX), genl.number(_HARD_IFINDEX, index))
    return genl.message(family, _SET_HARDIF, *ends, genl.number(_ELP_INTERVAL, round(interval_s * 1000)))


def _byte(kind: int, value: int) -> bytes:
    return genl.attribute(kind, bytes([value]))


@contextlib.contextmanager
def _sockets(namespace_fd: int) -> Iterator[tuple[NetlinkSocket, NetlinkSocket]]:
    """A route and a generic socket of a namespace."""
    with netns.returning():
        setns(namespace_fd, CLONE_NEWNET)
        route, generic = NetlinkSocket(), NetlinkSocket(genl.GENERIC)
    with contextlib.closing(route), contextlib.closing(generic):
        yield route, generic


def _request(sock: NetlinkSocket, orders: Sequence[bytes], ifname: str) -> None:
    try:
        sock.request(orders)
    except NetlinkError as error:
        raise OSError(
            error.errno, f"mesh interface {ifname}: {error.strerror or os.strerror(error.errno or 0)}"
        ) from error
