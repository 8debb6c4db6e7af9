"""Veths with both ends in the calling thread's namespace: the private paths of directed pairs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from netlab.kernel import messages, offloads
from netlab.kernel import namespaces as netns
from netlab.kernel.links import PER_BATCH, delete_group, highest_index, wait_until_running
from netlab.kernel.netlink import NetlinkError, NetlinkSocket

_FIRST_INDEX = 50_000  # above the far ends of the nodes' veths, so that a listing stays readable
_MTU_BYTES = 65_535  # never the bottleneck: the ports' own MTU rules
_LOCAL = b"\x02\x00\x5e"  # locally administered; nobody addresses these interfaces


@dataclass(frozen=True, slots=True)
class Pairs:
    """Interface indices of both ends of each veth, and the device group that they are deleted by (0: none made)."""

    indices: tuple[tuple[int, int], ...]
    group: int


def create(sock: NetlinkSocket, ifnames: Sequence[tuple[str, str]]) -> Pairs:
    """Create a veth per pair of names, both ends up, without addresses.

    Raises:
        OSError: The kernel refuses one; names it, and removes the others.
    """
    if not ifnames:
        return Pairs((), 0)
    first = max(_FIRST_INDEX, highest_index(sock) + 1)
    indices = tuple((first + 2 * n, first + 2 * n + 1) for n in range(len(ifnames)))
    made = Pairs(indices, group=first)
    try:
        _create(sock, ifnames, made)
        _raise_ends(sock, ifnames, indices)
        wait_until_running([(sock, near) for near, _ in indices])
    except BaseException:
        delete_group(sock, made.group)
        raise
    return made


def _create(sock: NetlinkSocket, ifnames: Sequence[tuple[str, str]], made: Pairs) -> None:
    here = netns.open_current()
    orders, labels = [], []
    for n, (names, (near, far)) in enumerate(zip(ifnames, made.indices, strict=True)):
        mac = _LOCAL + n.to_bytes(3, "big")
        orders.append(
            messages.create_veth(
                index=near,
                ifname=names[0],
                mac=mac,
                mtu=_MTU_BYTES,
                peer_index=far,
                peer_ifname=names[1],
                peer_fd=here,
                group=made.group,
            )
        )
        labels.append(names[0])
    try:
        _request(sock, orders, labels)
    finally:
        os.close(here)
    for ifname in (ifname for names in ifnames for ifname in names):
        offloads.disable_offloads(sock.fileno(), ifname)


def _raise_ends(sock: NetlinkSocket, ifnames: Sequence[tuple[str, str]], indices: Sequence[tuple[int, int]]) -> None:
    orders, labels = [], []
    quiet = netns.has_ipv6()
    for names, ends in zip(ifnames, indices, strict=True):
        for ifname, index in zip(names, ends, strict=True):
            made = [messages.no_ipv6_address(index)] if quiet else []
            made.append(messages.set_up(index, up=True))
            orders += made
            labels += [ifname] * len(made)
    _request(sock, orders, labels)


def _request(sock: NetlinkSocket, orders: Sequence[bytes], labels: Sequence[str]) -> None:
    try:
        sock.request(orders, at_most=PER_BATCH)
    except NetlinkError as error:
        raise OSError(error.errno, f"interface {labels[error.position]}: {error.strerror}") from error
