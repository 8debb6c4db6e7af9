"""Namespaces and veths of a whole lab in as few system calls as possible; then their far ends up or down.

Theory (measured for a line of 100 nodes). A veth is created *from the node's namespace* with its far end born in the
caller's namespace: moving an interface afterwards costs an RCU grace period each. Both interface indices are chosen
here, so that creation, address and "up" of a whole namespace go in one message batch without waiting for the kernel to
tell an index. The near ends come up at creation, the far ends last: no node sees a carrier before all is wired.
"""

from __future__ import annotations

import ipaddress
import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from netlab.errors import MachineError
from netlab.kernel import messages, offloads
from netlab.kernel import namespaces as netns
from netlab.kernel.netlink import HEADER, NetlinkError, NetlinkSocket
from netlab.kernel.syscalls import CLONE_NEWNET, setns

# Kernels that create fallback tunnels (tunl0, sit0, ...) in new namespaces take the first indices.
_FIRST_NODE_INDEX = 100
# Far indices differ from near ones: the kernel takes "peer has my index" for "not a veth" and then reports the carrier
# up to a second late (linkwatch_urgent_event in net/core/link_watch.c).
_FIRST_PEER_INDEX = 10_000
_CARRIER_WAIT_S = 5.0


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
    """What :func:`build` made. Everything goes when the last descriptor of each namespace is closed."""

    def __init__(
        self,
        namespace_fds: dict[str, int],
        veths: tuple[VethSpec, ...],
        peer_ifindex: tuple[int, ...],
        far: NetlinkSocket,
    ) -> None:
        self.namespace_fds = namespace_fds
        self.veths = veths
        self.peer_ifindex = peer_ifindex
        self._far = far

    def set_peers(self, indices: Iterable[int], *, up: bool) -> None:
        """Bring far ends up or down, which gives or takes the node's carrier.

        Args:
            indices: Positions in ``veths``.
            up: Whether they come up.

        Raises:
            OSError: The kernel refuses; names the interface.
        """
        chosen = list(indices)
        orders = [messages.set_up(self.peer_ifindex[i], up=up) for i in chosen]
        _request(self._far, orders, [f"far end {self.veths[i].peer_ifname}" for i in chosen])

    def close(self) -> None:
        """Close this process's descriptors; idempotent."""
        for fd in self.namespace_fds.values():
            os.close(fd)
        self.namespace_fds = {}
        self._far.close()


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

    def build(self) -> Wiring:
        try:
            first = max(_FIRST_PEER_INDEX, highest_index(self._far) + 1)
            self._peer_ifindex = tuple(range(first, first + len(self._veths)))
            with netns.returning() as far_fd:
                for name, positions in self._by_name.items():
                    self._build_namespace(name, positions, far_fd)
            self._raise_far_ends()
            self._wait_until_running()
        except BaseException:
            for fd in self._fds.values():
                os.close(fd)
            self._far.close()
            raise
        finally:
            for sock in self._near.values():
                sock.close()
        return Wiring(self._fds, self._veths, self._peer_ifindex, self._far)

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
            )
        ]
        if veth.address is not None:
            orders.append(messages.add_address(index, ipaddress.IPv4Interface(veth.address)))
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

    def _wait_until_running(self) -> None:
        """The kernel reports a carrier from a work queue, a moment later; until then frames are thrown away."""
        deadline = time.monotonic() + _CARRIER_WAIT_S
        waiting = [(self._near[veth.namespace].fileno(), veth.ifname) for veth in self._veths]
        waiting += [(self._far.fileno(), veth.peer_ifname) for veth in self._veths]
        while waiting := [(fd, ifname) for fd, ifname in waiting if not offloads.is_running(fd, ifname)]:
            if time.monotonic() > deadline:
                names = ", ".join(ifname for _, ifname in waiting[:5])
                raise OSError(f"{len(waiting)} interfaces have no carrier after {_CARRIER_WAIT_S:g} s: {names}")
            time.sleep(0.0005)


def enter(namespace_fd: int) -> None:
    """Move the calling thread into a network namespace of the wiring.

    Raises:
        OSError: Not a network namespace, or not permitted.
    """
    setns(namespace_fd, CLONE_NEWNET)


def _request(sock: NetlinkSocket, orders: Sequence[bytes], labels: Sequence[str]) -> None:
    try:
        sock.request(orders)
    except NetlinkError as error:
        raise OSError(error.errno, f"{labels[error.position]}: {error.strerror}") from error


def highest_index(sock: NetlinkSocket) -> int:
    """Return the largest interface index in the socket's namespace."""
    # struct ifinfomsg: family, pad, type (4 bytes), then the index
    dump = sock.dump(messages.encode_dump_links())
    return max(int.from_bytes(link[HEADER.size + 4 : HEADER.size + 8], "little") for link in dump)
