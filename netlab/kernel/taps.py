"""Mesh interfaces of meshes that are a process of the node: there, addressed and up, before it starts.

Taps, or where there are none one end of a veth.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
from collections.abc import Iterator

from pyroute2.netlink.rtnl.ifinfmsg import ifinfmsg

from netlab.kernel import links, messages, offloads, tun
from netlab.kernel import namespaces as netns
from netlab.kernel.netlink import NetlinkError, NetlinkSocket
from netlab.kernel.syscalls import CLONE_NEWNET, setns
from wnet.io.mesh_interface import FAR_END_SUFFIX


def create(namespace_fd: int, ifname: str, mac: bytes, address: str, mtu: int) -> None:
    """Make a tap in a node's namespace, up and addressed; the calling thread returns to its own.

    It has no carrier until a process takes its other end (:func:`netlab.kernel.tun.open_tap`).

    Args:
        namespace_fd: The node's network namespace.
        ifname: The interface's name.
        mac: Its address, 6 bytes.
        address: IPv4 with prefix length.
        mtu: Bytes.

    Raises:
        OSError: The kernel refuses; names the interface.
    """
    with _inside(namespace_fd) as sock:
        try:
            fd = tun.open_tap(ifname)
            try:
                tun.keep(fd)
            finally:
                os.close(fd)
            index = _index(sock, ifname)
            sock.request(
                [
                    _set_ends(index, mac, mtu),
                    messages.add_address(index, ipaddress.IPv4Interface(address)),
                    messages.set_up(index, up=True),
                ]
            )
        except NetlinkError as error:
            raise OSError(error.errno, f"mesh interface {ifname}: {error.strerror}") from error
        except OSError as error:
            raise OSError(error.errno, f"mesh interface {ifname}: {error.strerror} ({tun.DEVICE})") from error


def create_veth(namespace_fd: int, ifname: str, mac: bytes, address: str, mtu: int) -> None:
    """Make a mesh interface where there are no TAPs: one end of a veth, whose other end has the process of the mesh.

    As :func:`create`, but with a carrier from the start.

    Raises:
        OSError: The kernel refuses; names the interface.
    """
    with _inside(namespace_fd) as sock:
        here = netns.open_current()
        try:
            index = max(link.index for link in links.list_links(sock)) + 1
            far_ifname = ifname + FAR_END_SUFFIX
            order = messages.create_veth(
                index=index,
                ifname=ifname,
                mac=mac,
                mtu=mtu,
                peer_index=index + 1,
                peer_ifname=far_ifname,
                peer_fd=here,
                group=0,
            )
            quiet = [messages.no_ipv6_address(index + 1)] if netns.has_ipv6() else []
            near_address = messages.add_address(index, ipaddress.IPv4Interface(address))
            sock.request([order, *quiet, messages.set_up(index + 1, up=True), near_address])
            for name in (ifname, far_ifname):
                offloads.disable_offloads(sock.fileno(), name)
            links.wait_until_running([(sock, index), (sock, index + 1)])
        except NetlinkError as error:
            raise OSError(error.errno, f"mesh interface {ifname}: {error.strerror}") from error
        finally:
            os.close(here)


def wait_until_running(namespace_fd: int, ifname: str) -> None:
    """Wait until a tap whose other end is taken passes frames on.

    Raises:
        OSError: There is none, or it still has no carrier after half a minute.
    """
    with _inside(namespace_fd) as sock:
        links.wait_until_running([(sock, _index(sock, ifname))])


def _index(sock: NetlinkSocket, ifname: str) -> int:
    for link in links.list_links(sock):
        if link.ifname == ifname:
            return link.index
    raise OSError(f"there is no interface {ifname}")


def _set_ends(index: int, mac: bytes, mtu: int) -> bytes:
    message = ifinfmsg()
    message["index"] = index
    message["attrs"] = [("IFLA_ADDRESS", mac.hex(":")), ("IFLA_MTU", mtu)]
    return messages.encode_message(message, messages.RTM_NEWLINK, 0)


@contextlib.contextmanager
def _inside(namespace_fd: int) -> Iterator[NetlinkSocket]:
    """A route socket of a namespace, with the calling thread in it."""
    with netns.returning():
        setns(namespace_fd, CLONE_NEWNET)
        with contextlib.closing(NetlinkSocket()) as sock:
            yield sock
