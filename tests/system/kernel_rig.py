"""A lab of the netem engine, or any namespace, for tests on a real kernel: each test in a child that leaves nothing."""

from __future__ import annotations

import contextlib
import functools
import socket
import struct
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ParamSpec

import pytest

from netlab.engines.base import LabPlan
from netlab.engines.netem import NetemEngine
from netlab.kernel import messages, probe, wiring
from netlab.kernel import namespaces as netns
from netlab.kernel.netlink import HEADER, NetlinkSocket, attributes
from netlab.kernel.probe import TcFeatures
from netlab.medium.impairments import PERFECT, Impairment
from netlab.medium.segments import Port, Segment, SegmentKind

ETHERTYPE = 0x88B5  # for local experiments
BROADCAST = b"\xff" * 6
IFLA_IFNAME = 3
SO_RCVBUFFORCE, SO_TIMESTAMPNS = 33, 35  # asm-generic/socket.h
_Arguments = ParamSpec("_Arguments")


def in_lab(test: Callable[_Arguments, None]) -> Callable[_Arguments, None]:
    """Run a test as the root of a new network namespace, in a child process; its fixtures are made outside."""

    @functools.wraps(test)
    def run(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> None:
        def child() -> str | None:
            probe.become_lab_root()
            try:
                test(*arguments, **named)
            except BaseException:
                return traceback.format_exc()
            return None

        problem = probe.in_child(child)
        if problem is not None:
            pytest.fail(problem, pytrace=False)

    return run


def tc_features() -> TcFeatures:
    """What this kernel's traffic control offers, tried in a child."""
    found: list[TcFeatures] = []

    def child() -> TcFeatures:
        probe.become_lab_root()
        return probe.tc_features()

    problem = probe.in_child_value(child, found)
    if problem is not None:
        pytest.fail(problem)
    return found[0]


@contextlib.contextmanager
def visiting(namespace_fd: int) -> Iterator[None]:
    """Have the thread in another network namespace for a while."""
    with netns.returning():
        wiring.enter(namespace_fd)
        yield


def links_here() -> dict[str, tuple[int, dict[int, bytes]]]:
    """Name -> index and attributes of every interface in the current namespace."""
    with contextlib.closing(NetlinkSocket()) as sock:
        found = {}
        for link in sock.dump(messages.encode_dump_links()):
            attrs = attributes(link, HEADER.size + 16)
            index = struct.unpack_from("=i", link, HEADER.size + 4)[0]
            found[attrs[IFLA_IFNAME].rstrip(b"\0").decode()] = index, attrs
        return found


def plan(kind: SegmentKind, count: int, impairment: Impairment = PERFECT, monitor: int | None = None) -> LabPlan:
    """``count`` nodes n0, n1, ... with one port each on one segment, all pairs alike."""
    ports = tuple(
        Port(i, f"n{i}", "radio0", bytes([2, 0, 0, 0, 0, i]), f"10.0.0.{i + 1}/24", monitor=i == monitor)
        for i in range(count)
    )
    pairs = {(i, j): impairment for i in range(count) for j in range(count) if i != j}
    segment = Segment("s", kind, tuple(range(count)), pairs)
    return LabPlan("lab", 7, tuple(port.node for port in ports), ports, (segment,))


@dataclass
class Node:
    """A packet socket on a node's interface that sees every frame of the test's type."""

    mac: bytes
    sock: socket.socket

    def send(self, destination: bytes, payload: bytes) -> None:
        self.sock.send(destination + self.mac + struct.pack("!H", ETHERTYPE) + payload)

    def burst(self, destination: bytes, count: int, *, size_bytes: int = 60, every_s: float = 0.0) -> None:
        """Frames whose payload begins with their number and the time of sending, see :meth:`arrivals`."""
        begin = time.monotonic()
        for number in range(count):
            time.sleep(max(0.0, begin + number * every_s - time.monotonic()) if every_s else 0)
            stamp = struct.pack("!Id", number, time.monotonic())
            self.send(destination, stamp.ljust(size_bytes, b"\0"))

    def received(self, wait_s: float = 0.05) -> list[bytes]:
        """Payloads until nothing has come for ``wait_s``."""
        found = []
        self.sock.settimeout(wait_s)
        with contextlib.suppress(TimeoutError):
            while True:
                frame, address = self.sock.recvfrom(2000)
                if address[2] != socket.PACKET_OUTGOING:
                    found.append(frame[14:])
        return found

    def arrivals(self, wait_s: float = 0.2) -> list[tuple[int, float, float]]:
        """Number, delay and time of arrival by the kernel's stamp, in s, of each frame of a burst, as they came."""
        offset_s = time.time() - time.monotonic()
        found = []
        self.sock.settimeout(wait_s)
        with contextlib.suppress(TimeoutError):
            while True:
                frame, ancillary, _, address = self.sock.recvmsg(2000, 64)
                if address[2] != socket.PACKET_OUTGOING:
                    seconds, nanoseconds = struct.unpack("=qq", ancillary[0][2])
                    number, sent_s = struct.unpack_from("!Id", frame, 14)
                    arrived_s = seconds - offset_s + nanoseconds / 1e9
                    found.append((number, arrived_s - sent_s, arrived_s))
        return found


@contextlib.contextmanager
def running(lab: LabPlan) -> Iterator[tuple[NetemEngine, list[Node]]]:
    """The netem engine, up, and a packet socket in every node."""
    engine = NetemEngine(lab)
    engine.bring_up()
    nodes = []
    for port in lab.ports:
        with visiting(engine.namespace_fds[port.node]):
            sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETHERTYPE))
            sock.bind((port.ifname, ETHERTYPE))
            quiet(port.ifname)
        with contextlib.suppress(PermissionError):  # an ordinary user has to do with less
            sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 24)
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        nodes.append(Node(port.mac, sock))
    try:
        yield engine, nodes
    finally:
        for node in nodes:
            node.sock.close()
        engine.close()


def quiet(ifname: str) -> None:
    """Switch IPv6 off at an interface here: its solicitations and reports would be counted, too."""
    switch = Path(f"/proc/sys/net/ipv6/conf/{ifname}/disable_ipv6")
    if switch.exists():
        switch.write_text("1")


def who_gets(nodes: list[Node], sender: int, destination: bytes) -> list[int]:
    """Indices of the nodes that receive a frame, once per copy."""
    nodes[sender].send(destination, b"x" * 60)
    return [index for index, node in enumerate(nodes) for _ in node.received(0.02)]
