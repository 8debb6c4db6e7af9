"""The rtnetlink messages about links and addresses that a lab is built from, encoded by pyroute2.

Each ``encode_*`` function is plain pyroute2; where many messages of one shape are sent, the function without the prefix
gives the same bytes from a cached :class:`~netlab.kernel.templates.Template`. Sequence numbers and ACK flags are added
by :mod:`netlab.kernel.netlink`.
"""

from __future__ import annotations

import functools
import ipaddress
import socket
import struct
from typing import Any

from pyroute2.netlink.rtnl.ifaddrmsg import ifaddrmsg
from pyroute2.netlink.rtnl.ifinfmsg import ifinfmsg

from netlab.kernel.templates import Template

RTM_NEWLINK = 16
RTM_DELLINK = 17
RTM_GETLINK = 18
RTM_NEWADDR = 20
RTM_NEWQDISC = 36
RTM_DELQDISC = 37
RTM_NEWTFILTER = 44

NLM_F_REQUEST = 0x1
NLM_F_ACK = 0x4
NLM_F_DUMP = 0x300
NLM_F_REPLACE = 0x100
NLM_F_EXCL = 0x200
NLM_F_CREATE = 0x400

IFF_UP = 0x1
LOOPBACK_INDEX = 1  # in every network namespace: it is made first

_IN6_ADDR_GEN_MODE_NONE = 1  # linux/if_link.h
_RTEXT_FILTER_SKIP_STATS = 8  # linux/rtnetlink.h
_IFLA_IFNAME = 3
_NAME_BYTES_MAX = 15  # IFNAMSIZ less the final zero

_U32 = struct.Struct("=I")
# Marker values: nothing else in these messages has such bytes.
_MARK_INDEX = 0x7AB1C2D3
_MARK_PEER_INDEX = 0x7AB4C5D6
_MARK_MTU = 0xE1F2A3B4
_MARK_FD = 0xE5F6A7B8
_MARK_GROUP = 0x7AB7C8D9
_MARK_MAC = bytes.fromhex("fa1eb2c3d4e5")
_MARK_ADDRESS = bytes.fromhex("f1f2e3e4")
_MARK_BROADCAST = bytes.fromhex("f5f6e7e8")
_MARK_NAME = "\x01#~&\x02!^+\x03*=\x04%\x05@"
_MARK_PEER_NAME = "\x06$|?\x0e>;\x0f<\x10]\x11[\x12}"


def encode_message(message: Any, kind: int, flags: int) -> bytes:
    """Set type and flags of a pyroute2 message and return its bytes."""
    message["header"]["type"] = kind
    message["header"]["flags"] = NLM_F_REQUEST | flags
    message.encode()
    return bytes(message.data)


def encode_create_veth(
    *, index: int, ifname: str, mac: bytes, mtu: int, peer_index: int, peer_ifname: str, peer_fd: int, group: int
) -> bytes:
    """RTM_NEWLINK of a veth whose near end is up at once and whose far end is born in the namespace ``peer_fd``.

    The far end is put into ``group``, by which many can be deleted at once.
    """
    peer_attrs = [("IFLA_IFNAME", peer_ifname), ("IFLA_MTU", mtu), ("IFLA_GROUP", group), ("IFLA_NET_NS_FD", peer_fd)]
    peer = {"index": peer_index, "attrs": peer_attrs}
    info = [("IFLA_INFO_KIND", "veth"), ("IFLA_INFO_DATA", {"attrs": [("VETH_INFO_PEER", peer)]})]
    message = ifinfmsg()
    message["index"] = index
    message["flags"] = message["change"] = IFF_UP
    message["attrs"] = [
        ("IFLA_IFNAME", ifname),
        ("IFLA_ADDRESS", mac.hex(":")),
        ("IFLA_MTU", mtu),
        ("IFLA_LINKINFO", {"attrs": info}),
    ]
    return encode_message(message, RTM_NEWLINK, NLM_F_CREATE | NLM_F_EXCL)


def create_veth(
    *, index: int, ifname: str, mac: bytes, mtu: int, peer_index: int, peer_ifname: str, peer_fd: int, group: int
) -> bytes:
    """The bytes of :func:`encode_create_veth`, from a template per pair of name lengths.

    Raises:
        ValueError: A name is empty or longer than 15 bytes, or ``mac`` is not 6 bytes.
    """
    name, peer_name = _name(ifname), _name(peer_ifname)
    return _veth_template(len(name), len(peer_name)).fill(
        {
            "index": _U32.pack(index),
            "name": _name_hole(name),
            "mac": mac,
            "mtu": _U32.pack(mtu),
            "peer_index": _U32.pack(peer_index),
            "peer_name": _name_hole(peer_name),
            "peer_fd": _U32.pack(peer_fd),
            "group": _U32.pack(group),
        }
    )


@functools.lru_cache(maxsize=256)
def _veth_template(name_bytes: int, peer_name_bytes: int) -> Template:
    name, peer_name = _MARK_NAME[:name_bytes], _MARK_PEER_NAME[:peer_name_bytes]
    encoded = encode_create_veth(
        index=_MARK_INDEX,
        ifname=name,
        mac=_MARK_MAC,
        mtu=_MARK_MTU,
        peer_index=_MARK_PEER_INDEX,
        peer_ifname=peer_name,
        peer_fd=_MARK_FD,
        group=_MARK_GROUP,
    )
    markers = {
        "index": _U32.pack(_MARK_INDEX),
        "name": _name_hole(name.encode()),
        "mac": _MARK_MAC,
        "mtu": _U32.pack(_MARK_MTU),
        "peer_index": _U32.pack(_MARK_PEER_INDEX),
        "peer_name": _name_hole(peer_name.encode()),
        "peer_fd": _U32.pack(_MARK_FD),
        "group": _U32.pack(_MARK_GROUP),
    }
    return Template(encoded, markers, mtu=2)


def _name_hole(name: bytes) -> bytes:
    # With its attribute header and final zero: the one byte of a short name alone would be found anywhere.
    return struct.pack("=HH", 4 + len(name) + 1, _IFLA_IFNAME) + name + b"\0"


def encode_add_address(index: int, interface: ipaddress.IPv4Interface) -> bytes:
    """RTM_NEWADDR with local address, prefix and (prefixes shorter than /31) the broadcast address."""
    message = ifaddrmsg()
    message["family"] = socket.AF_INET
    message["prefixlen"] = interface.network.prefixlen
    message["index"] = index
    message["attrs"] = [("IFA_LOCAL", str(interface.ip)), ("IFA_ADDRESS", str(interface.ip))]
    if interface.network.prefixlen < 31:
        message["attrs"].append(("IFA_BROADCAST", str(interface.network.broadcast_address)))
    return encode_message(message, RTM_NEWADDR, NLM_F_CREATE | NLM_F_EXCL)


def add_address(index: int, interface: ipaddress.IPv4Interface) -> bytes:
    """The bytes of :func:`encode_add_address`, from a template per prefix length."""
    values = {"index": _U32.pack(index), "address": interface.ip.packed}
    if interface.network.prefixlen < 31:
        values["broadcast"] = interface.network.broadcast_address.packed
    return _address_template(interface.network.prefixlen).fill(values)


@functools.lru_cache(maxsize=64)
def _address_template(prefix_bits: int) -> Template:
    # Encoded with a real broadcast address, which is then exchanged for a marker: pyroute2 is given what it expects.
    message = ifaddrmsg()
    message["family"] = socket.AF_INET
    message["prefixlen"] = prefix_bits
    message["index"] = _MARK_INDEX
    local = socket.inet_ntoa(_MARK_ADDRESS)
    message["attrs"] = [("IFA_LOCAL", local), ("IFA_ADDRESS", local)]
    markers = {"index": _U32.pack(_MARK_INDEX), "address": _MARK_ADDRESS}
    if prefix_bits < 31:
        message["attrs"].append(("IFA_BROADCAST", socket.inet_ntoa(_MARK_BROADCAST)))
        markers["broadcast"] = _MARK_BROADCAST
    return Template(encode_message(message, RTM_NEWADDR, NLM_F_CREATE | NLM_F_EXCL), markers, address=2)


def encode_set_up(index: int, *, up: bool) -> bytes:
    """RTM_NEWLINK that brings an existing interface up or down."""
    message = ifinfmsg()
    message["index"] = index
    message["flags"] = IFF_UP if up else 0
    message["change"] = IFF_UP
    return encode_message(message, RTM_NEWLINK, 0)


def set_up(index: int, *, up: bool) -> bytes:
    """The bytes of :func:`encode_set_up`, from a template."""
    return _set_up_template(up).fill({"index": _U32.pack(index)})


@functools.lru_cache(maxsize=2)
def _set_up_template(up: bool) -> Template:
    return Template(encode_set_up(_MARK_INDEX, up=up), {"index": _U32.pack(_MARK_INDEX)})


def encode_no_ipv6_address(index: int) -> bytes:
    """RTM_NEWLINK that keeps the kernel from giving the interface an IPv6 address by itself (while it is down)."""
    message = ifinfmsg()
    message["index"] = index
    inet6 = {"attrs": [("IFLA_INET6_ADDR_GEN_MODE", _IN6_ADDR_GEN_MODE_NONE)]}
    message["attrs"] = [("IFLA_AF_SPEC", {"attrs": [("AF_INET6", inet6)]})]
    return encode_message(message, RTM_NEWLINK, 0)


def no_ipv6_address(index: int) -> bytes:
    """The bytes of :func:`encode_no_ipv6_address`, from a template."""
    return _no_ipv6_template().fill({"index": _U32.pack(index)})


@functools.lru_cache(maxsize=1)
def _no_ipv6_template() -> Template:
    return Template(encode_no_ipv6_address(_MARK_INDEX), {"index": _U32.pack(_MARK_INDEX)})


def encode_delete_group(group: int) -> bytes:
    """RTM_DELLINK of all interfaces of a group; of a veth both ends go.

    Together they cost one grace period of the kernel; one after the other, one each (about 17 ms).
    """
    message = ifinfmsg()
    message["attrs"] = [("IFLA_GROUP", group)]
    return encode_message(message, RTM_DELLINK, 0)


def encode_get_link(index: int) -> bytes:
    """RTM_GETLINK of one interface, without its statistics."""
    message = ifinfmsg()
    message["index"] = index
    message["attrs"] = [("IFLA_EXT_MASK", _RTEXT_FILTER_SKIP_STATS)]
    return encode_message(message, RTM_GETLINK, 0)


def get_link(index: int) -> bytes:
    """The bytes of :func:`encode_get_link`, from a template."""
    return _get_link_template().fill({"index": _U32.pack(index)})


@functools.lru_cache(maxsize=1)
def _get_link_template() -> Template:
    return Template(encode_get_link(_MARK_INDEX), {"index": _U32.pack(_MARK_INDEX)})


def encode_dump_links() -> bytes:
    """RTM_GETLINK of every interface in the socket's namespace, without its statistics."""
    message = ifinfmsg()
    message["attrs"] = [("IFLA_EXT_MASK", _RTEXT_FILTER_SKIP_STATS)]
    return encode_message(message, RTM_GETLINK, NLM_F_DUMP)


def _name(ifname: str) -> bytes:
    name = ifname.encode()
    if not 1 <= len(name) <= _NAME_BYTES_MAX:
        raise ValueError(f"interface name {ifname!r} must have 1 to {_NAME_BYTES_MAX} bytes")
    return name
