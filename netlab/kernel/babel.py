"""What babeld needs of a node, and how it is started: Debian's babeld (RFC 8966), the comparison that routes IP.

The node's address, a /32, is on `lo` and on all members: unnumbered interfaces, whose routes go to a neighbour's
address on the link (babeld installs them as such). Babel speaks over the members' link-local IPv6 addresses.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import shutil
import socket
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

from pyroute2.netlink.rtnl.ifaddrmsg import ifaddrmsg

from netlab.kernel import links, messages
from netlab.kernel import namespaces as netns
from netlab.kernel.netlink import NetlinkError, NetlinkSocket
from netlab.kernel.syscalls import CLONE_NEWNET, setns
from netlab.medium.meshes import BabelOptions

_LINK_LOCAL_BITS = 64
_SCOPE_LINK = 253
_IFA_F_NODAD = 0x02
_ROUTE_COLUMNS = 3  # interface, destination, gateway
_SYSCTLS = {"ipv4/ip_forward": "1", "ipv4/conf/all/rp_filter": "0", "ipv4/conf/default/rp_filter": "0"}


def program() -> str | None:
    """Path of babeld; None where it is not installed."""
    return shutil.which("babeld", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")


def argv(members: Sequence[str], options: BabelOptions) -> tuple[str, ...]:
    """The program in a node whose members have these names."""
    settings = [
        f"default type {'wireless' if options.wireless else 'wired'} hello-interval {options.hello_interval_s:g}"
        f" update-interval {4 * options.hello_interval_s:g}",
        "redistribute local ip 10.240.0.0/16",
        "redistribute local deny",
    ]
    words = [word for setting in settings for word in ("-C", setting)]
    # Below the node's own /run, and never /dev/null: babeld deletes its files, with root's rights.
    return (program() or "babeld", "-I", "/run/babeld.pid", "-S", "/run/babeld.state", *words, *members)


def create(namespace_fd: int, address: str, members: Mapping[str, bytes]) -> None:
    """Give a node its address, its members' link-local ones, and have it forward; the calling thread returns.

    Args:
        namespace_fd: The node's network namespace.
        address: IPv4 with prefix length 32.
        members: MAC address by name of the interface.

    Raises:
        OSError: The kernel refuses, or has no IPv6.
    """
    with netns.returning():
        setns(namespace_fd, CLONE_NEWNET)
        if not netns.has_ipv6():
            raise OSError("babeld needs IPv6, which this kernel lacks")
        for name, value in _SYSCTLS.items():
            Path(f"/proc/sys/net/{name}").write_text(value)
        with contextlib.closing(NetlinkSocket()) as sock:
            index = {link.ifname: link.index for link in links.list_links(sock)}
            host = ipaddress.IPv4Interface(address)
            orders = [messages.add_address(index[name], host) for name in ("lo", *members)]
            orders += [_link_local(index[name], mac) for name, mac in members.items()]
            try:
                sock.request(orders)
            except NetlinkError as error:
                raise OSError(error.errno, f"address {address}: {error.strerror}") from error


def routed(namespace_fd: int) -> set[bytes]:
    """Return the addresses, of 4 bytes, of other nodes to which this node has a route now."""
    with netns.returning():
        setns(namespace_fd, CLONE_NEWNET)
        rows = [line.split() for line in Path("/proc/thread-self/net/route").read_text().splitlines()[1:]]
    return {struct.pack("=I", int(row[1], 16)) for row in rows if len(row) >= _ROUTE_COLUMNS}


def _link_local(index: int, mac: bytes) -> bytes:
    """RTM_NEWADDR of the address that RFC 4291, appendix A, makes of a MAC; in use at once."""
    host = bytes([mac[0] ^ 0x02]) + mac[1:3] + b"\xff\xfe" + mac[3:]
    message = ifaddrmsg()
    message["family"] = socket.AF_INET6
    message["prefixlen"] = _LINK_LOCAL_BITS
    message["index"] = index
    message["scope"] = _SCOPE_LINK
    message["flags"] = _IFA_F_NODAD
    message["attrs"] = [("IFA_ADDRESS", str(ipaddress.IPv6Address(b"\xfe\x80" + bytes(6) + host)))]
    return messages.encode_message(message, messages.RTM_NEWADDR, messages.NLM_F_CREATE | messages.NLM_F_EXCL)
