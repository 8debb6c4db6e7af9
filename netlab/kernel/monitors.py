"""Radios in monitor mode that the lab plays: TAPs of the type 802.11 with radiotap header, by their descriptors.

For programs one is what a card in monitor mode is (ARPHRD 803, whole 802.11 frames), but for its address: a TAP of this
type has none. Source: linux/if_tun.h, TUNSETLINK in drivers/net/tun.c.
"""

from __future__ import annotations

import contextlib
import fcntl
import os

from pyroute2.netlink.rtnl.ifinfmsg import ifinfmsg

from netlab.kernel import links, messages, tun
from netlab.kernel import namespaces as netns
from netlab.kernel.netlink import NetlinkError, NetlinkSocket
from netlab.kernel.syscalls import CLONE_NEWNET, setns
from wnet.config import MEMBER_MTU_BYTES

ARPHRD_RADIOTAP = 803
_TUNSETLINK = 0x400454CD
_TUNSETCARRIER = 0x400454E2
#: Room for radiotap and 802.11 headers around a member's frame.
MTU_BYTES = MEMBER_MTU_BYTES + 60


def create(namespace_fd: int, ifname: str) -> int:
    """Make one in a node's namespace, up; the calling thread returns to its own.

    Returns:
        Its other end, which does not block: reads give what programs send, writes what the radio hears.

    Raises:
        OSError: The kernel refuses; names the interface.
    """
    with netns.returning():
        setns(namespace_fd, CLONE_NEWNET)
        try:
            fd = tun.open_tap(ifname)
        except OSError as error:
            raise OSError(error.errno, f"interface {ifname}: {error.strerror} ({tun.DEVICE})") from error
        try:
            fcntl.ioctl(fd, _TUNSETLINK, ARPHRD_RADIOTAP)
            os.set_blocking(fd, False)
            with contextlib.closing(NetlinkSocket()) as sock:
                index = next(link.index for link in links.list_links(sock) if link.ifname == ifname)
                sock.request([_settings(index), messages.set_up(index, up=True)])
        except NetlinkError as error:
            os.close(fd)
            raise OSError(error.errno, f"interface {ifname}: {error.strerror}") from error
        except BaseException:
            os.close(fd)
            raise
    return fd


def set_carrier(fd: int, *, up: bool) -> None:
    """Give or take an interface's carrier, by its other end."""
    fcntl.ioctl(fd, _TUNSETCARRIER, int(up).to_bytes(4, "little"))


def _settings(index: int) -> bytes:
    message = ifinfmsg()
    message["index"] = index
    message["attrs"] = [("IFLA_MTU", MTU_BYTES)]
    return messages.encode_message(message, messages.RTM_NEWLINK, 0)
