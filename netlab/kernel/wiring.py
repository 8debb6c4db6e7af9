"""Namespaces and veths of a whole lab in as few system calls as possible; then their far ends up or down.

Theory (measured for a line of 100 nodes). A veth is created *from the node's namespace* with its far end born in the
caller's namespace: moving an interface afterwards costs an RCU grace period each. Both interface indices are chosen
here, so that creation, address and "up" of a whole namespace go in one message batch without waiting for the kernel to
tell an index. The near ends come up at creation, the far ends last: no node sees a carrier before all is wired.
"""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from netlab.errors import MachineError
from netlab.kernel import links, messages, offloads
from netlab.kernel import namespaces as netns
from netlab.kernel.netlink import NetlinkError, NetlinkSocket
from netlab.kernel.syscalls import CLONE_NEWNET, setns

# Kernels that create fallback tunnels (tunl0, sit0, ...) in new namespaces take the first indices.
_FIRST_NODE_INDEX = 100
# Far indices differ from near ones: the kernel takes "peer has my index" for "not a veth" and then reports the carrier
# up to a second late (linkwatch_urgent_event in net/core/link_watch.c).
_FIRST_PEER_INDEX = 10_000


@dataclass(frozen=True, slots=True)
class VethSpec:
    """One veth: the near end in a node's namespace, the far end ``peer_ifname`` where the medium lives.

    ``mac`` is 6 bytes, ``address`` IPv4 with prefix length (``10.1.0.1/24``) or None, ``mtu`` in bytes.
    """

    namespace: str
    ifname: str
    mac: bytes
    address: str | None
    mtu: int
    peer_ifname: str


class Wiring:
    """What :func:`build` made. A node's namespace goes when the last descriptor of it is closed."""

    def __init__(
        self,
        namespace_fds: dict[str, int],
        veths: tuple[VethSpec, ...],
        peer_ifindex: tuple[int, ...],
        far: NetlinkSocket,
        group: int,
    ) -> None:
        self.namespace_fds = namespace_fds
        self.veths = veths
        self.peer_ifindex = peer_ifindex
        self._far: NetlinkSocket | None = far
        self._group = group

    def set_peers(self, indices: Iterable[int], *, up: bool) -> None:
        """Bring far ends up or down, which gives or takes the node's carrier.

        Args:
            indices: Positions in ``veths``.
            up: Whether they come up.

        Raises:
            OSError: The kernel refuses; names the interface.
        """
        if self._far is None:
            raise RuntimeError("the wiring is closed")
        chosen = list(indices)
        orders = [messages.set_up(self.peer_ifindex[i], up=up) for i in chosen]
        _request(self._far, orders, [f"far end {self.veths[i].peer_ifname}" for i in chosen])

    def close(self) -> None:
        """Delete the veths and close this process's descriptors; idempotent.

        The kernel would delete them with the last descriptor of their namespaces, but later, and their names and
        indices would be taken until then.
        """
        if self._far is not None:
            links.delete_group(self._far, self._group)
            self._far.close()
        self._far = None
        for fd in self.namespace_fds.values():
            os.close(fd)
        self.namespace_fds = {}


def build(namespaces: Sequence[str], veths: Sequence[VethSpec]) -> Wiring:
    """Create a network namespace per name and all veths, addressed, up and running at both ends.

    The calling thread visits the new namespaces and returns to its own, where the far ends are.

    Args:
        namespaces: Their names, distinct.
        veths: Every interface; ``namespace`` is one of ``namespaces``.

    Raises:
        MachineError: The kernel refuses namespaces or veths.
        OSError: The kernel refuses one of the interfaces; the text names interface and namespace.
        ValueError: Unknown or repeated name, or an impossible address.
    """
    by_name: dict[str, list[int]] = {name: [] for name in namespaces}
    if len(by_name) != len(namespaces):
        raise ValueError("namespace names are not distinct")
    for position, veth in enumerate(veths):
        if veth.namespace not in by_name:
            raise ValueError(f"interface {veth.ifname}: no namespace {veth.namespace!r}")
        by_name[veth.namespace].append(position)
    return _Builder(by_name, tuple(veths)).build()


class _Builder:
    """Holds what exists so far, so that a failure in the middle leaves nothing."""

    def __init__(self, by_name: dict[str, list[int]], veths: tuple[VethSpec, ...]) -> None:
        self._by_name = by_name
        self._veths = veths
        self._far = NetlinkSocket()
        self._near: dict[str, NetlinkSocket] = {}
        self._fds: dict[str, int] = {}
        self._peer_ifindex: tuple[int, ...] = ()
        self._group = 0

    def build(self) -> Wiring:
        try:
            first = max(_FIRST_PEER_INDEX, links.highest_index(self._far) + 1)
            self._peer_ifindex = tuple(range(first, first + len(self._veths)))
            self._group = first
            with netns.returning() as far_fd:
                for name, positions in self._by_name.items():
                    self._build_namespace(name, positions, far_fd)
            self._raise_far_ends()
            links.wait_until_running(self._near_ends())
        except BaseException:
            self._wiring().close()
            raise
        finally:
            for sock in self._near.values():
                sock.close()
        return self._wiring()

    def _near_ends(self) -> list[tuple[NetlinkSocket, int]]:
        return [
            (self._near[name], _FIRST_NODE_INDEX + offset)
            for name, positions in self._by_name.items()
            for offset in range(len(positions))
        ]

    def _wiring(self) -> Wiring:
        return Wiring(self._fds, self._veths, self._peer_ifindex, self._far, self._group)

    def _build_namespace(self, name: str, positions: list[int], far_fd: int) -> None:
        try:
            self._fds[name] = netns.enter_new()
            near = self._near[name] = NetlinkSocket()
        except OSError as error:
            raise MachineError(
                f"node {name}: no network namespace: {error}; `netlab doctor` says what this machine allows"
            ) from error
        orders = [messages.set_up(messages.LOOPBACK_INDEX, up=True)]
        labels = [f"node {name}: interface lo"]
        for offset, position in enumerate(positions):
            made = self._interface_orders(position, _FIRST_NODE_INDEX + offset, far_fd)
            orders += made
            labels += [f"node {name}: interface {self._veths[position].ifname}"] * len(made)
        _request(near, orders, labels)
        for position in positions:
            offloads.disable_offloads(near.fileno(), self._veths[position].ifname)

    def _interface_orders(self, position: int, index: int, far_fd: int) -> list[bytes]:
        veth = self._veths[position]
        orders = [
            messages.create_veth(
                index=index,
                ifname=veth.ifname,
                mac=veth.mac,
                mtu=veth.mtu,
                peer_index=self._peer_ifindex[position],
                peer_ifname=veth.peer_ifname,
                peer_fd=far_fd,
                group=self._group,
            )
        ]
        if veth.address is not None:
            orders.append(messages.add_address(index, ipaddress.IPv4Interface(veth.address)))
        elif netns.has_ipv6():  # it belongs to a mesh: no address of either kind
            orders.append(messages.no_ipv6_address(index))
        return orders

    def _raise_far_ends(self) -> None:
        orders, labels = [], []
        quiet = netns.has_ipv6()
        for veth, index in zip(self._veths, self._peer_ifindex, strict=True):
            offloads.disable_offloads(self._far.fileno(), veth.peer_ifname)
            made = [messages.no_ipv6_address(index)] if quiet else []
            made.append(messages.set_up(index, up=True))
            orders += made
            labels += [f"far end {veth.peer_ifname} of {veth.namespace} {veth.ifname}"] * len(made)
        _request(self._far, orders, labels)


def enter(namespace_fd: int) -> None:
    """Move the calling thread into a network namespace of the wiring.

    Raises:
        OSError: Not a network namespace, or not permitted.
    """
    setns(namespace_fd, CLONE_NEWNET)


def _request(sock: NetlinkSocket, orders: Sequence[bytes], labels: Sequence[str]) -> None:
    try:
        sock.request(orders, at_most=links.PER_BATCH)
    except NetlinkError as error:
        raise OSError(error.errno, f"{labels[error.position]}: {error.strerror}") from error
