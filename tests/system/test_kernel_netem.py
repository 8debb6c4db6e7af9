"""The netem engine's devices and filters on a real kernel.

Where the kernel lacks sch_netem, the paths of frames are still tried: a plain FIFO then stands where netem would. The
tests of delay, loss and outage need sch_netem and are skipped without it.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from pyroute2.netlink.rtnl.tcmsg import tcmsg

from netlab.engines import netem
from netlab.engines.base import LabPlan
from netlab.engines.netem import NetemEngine
from netlab.errors import MachineError
from netlab.kernel import messages, probe, tc, wiring
from netlab.kernel import namespaces as netns
from netlab.kernel.netlink import HEADER, NetlinkSocket, attributes
from netlab.kernel.probe import TcFeatures
from netlab.medium.impairments import PERFECT, Impairment, PeriodicLoss, RandomLoss
from netlab.medium.segments import Port, Segment, SegmentKind

ETHERTYPE = 0x88B5  # for local experiments
BROADCAST = b"\xff" * 6
UNKNOWN = bytes.fromhex("0200000000ff")
IFLA_IFNAME = 3
RTM_NEWQDISC = 36


@pytest.fixture
def in_lab() -> Callable[[Callable[[], None]], None]:
    """Run the body of a test as the root of a new network namespace, in a child that leaves nothing behind."""

    def run(body: Callable[[], None]) -> None:
        def child() -> str | None:
            probe.become_lab_root()
            try:
                body()
            except BaseException:
                return traceback.format_exc()
            return None

        problem = probe.in_child(child)
        if problem is not None:
            pytest.fail(problem)

    return run


def features() -> TcFeatures:
    found: list[TcFeatures] = []

    def child() -> TcFeatures:
        probe.become_lab_root()
        return probe.tc_features()

    problem = probe.in_child_value(child, found)
    if problem is not None:
        pytest.fail(problem)
    return found[0]


@pytest.fixture
def netem_kernel() -> None:
    problem = features().netem_problem
    if problem is not None:
        pytest.skip(f"{problem}; the tests of its physics run on a kernel that has it")


def _fifo(ifindex: int, impairment: Impairment, *, seed: int) -> bytes:
    message = tcmsg()
    message["index"], message["handle"], message["parent"] = ifindex, 0x10000, 0xFFFFFFFF
    message["attrs"] = [("TCA_KIND", "pfifo")]
    return messages.encode_message(message, RTM_NEWQDISC, messages.NLM_F_CREATE | messages.NLM_F_EXCL)


@pytest.fixture(params=list(tc.Classifier))
def any_kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the engine come up with this classifier, with or without sch_netem."""
    found = features()
    if request.param not in found.classifiers:
        pytest.skip(f"this kernel has no classifier {request.param}")
    monkeypatch.setattr(netem, "tc_features", lambda: TcFeatures(None, (request.param,), False))
    if found.netem_problem is not None:
        monkeypatch.setattr(tc, "add_netem", _fifo)


def plan(kind: SegmentKind, count: int, impairment: Impairment = PERFECT, monitor: int | None = None) -> LabPlan:
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


@contextlib.contextmanager
def running(lab: LabPlan) -> Iterator[tuple[NetemEngine, list[Node]]]:
    engine = NetemEngine(lab)
    engine.bring_up()
    nodes = []
    for port in lab.ports:
        with netns.returning():
            wiring.enter(engine.namespace_fds[port.node])
            sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETHERTYPE))
            sock.bind((port.ifname, ETHERTYPE))
        nodes.append(Node(port.mac, sock))
    try:
        yield engine, nodes
    finally:
        for node in nodes:
            node.sock.close()
        engine.close()


def who_gets(nodes: list[Node], sender: int, destination: bytes) -> list[int]:
    nodes[sender].send(destination, b"x" * 60)
    return [index for index, node in enumerate(nodes) for _ in node.received(0.02)]


@pytest.mark.usefixtures("any_kernel")
def test_radio_frames_reach_who_should_hear_them(in_lab: Callable[[Callable[[], None]], None]) -> None:
    def body() -> None:
        with running(plan(SegmentKind.RADIO, 4, monitor=3)) as (_, nodes):
            assert who_gets(nodes, 0, BROADCAST) == [1, 2, 3]
            assert who_gets(nodes, 0, bytes.fromhex("01005e000001")) == [1, 2, 3]
            assert who_gets(nodes, 0, nodes[1].mac) == [1, 3]
            assert who_gets(nodes, 1, nodes[3].mac) == [3]
            assert who_gets(nodes, 3, nodes[0].mac) == [0]
            assert who_gets(nodes, 0, UNKNOWN) == [3]

    in_lab(body)


@pytest.mark.usefixtures("any_kernel")
def test_wires_carry_everything(in_lab: Callable[[Callable[[], None]], None]) -> None:
    def body() -> None:
        with running(plan(SegmentKind.WIRE, 2)) as (engine, nodes):
            assert who_gets(nodes, 0, UNKNOWN) == [1]
            assert who_gets(nodes, 1, BROADCAST) == [0]
            engine.set_carrier({1}, up=False)
            assert who_gets(nodes, 0, BROADCAST) == []
            engine.set_carrier({1}, up=True)
            assert who_gets(nodes, 0, BROADCAST) == [1]
        with running(plan(SegmentKind.WIRE, 3)) as (_, nodes):
            assert who_gets(nodes, 2, UNKNOWN) == [0, 1]

    in_lab(body)


@pytest.mark.usefixtures("any_kernel")
def test_more_receivers_than_one_filter_holds(in_lab: Callable[[Callable[[], None]], None]) -> None:
    def body() -> None:
        count = tc.ACTIONS_MAX + 3
        with running(plan(SegmentKind.WIRE, count)) as (_, nodes):
            nodes[5].send(BROADCAST, b"x" * 60)
            assert [len(node.received(0.005)) for node in nodes] == [int(i != 5) for i in range(count)]

    in_lab(body)


@pytest.mark.usefixtures("any_kernel")
def test_close_and_failure_leave_no_interface(
    in_lab: Callable[[Callable[[], None]], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    def pair_interfaces() -> list[str]:
        with contextlib.closing(NetlinkSocket()) as sock:
            links = sock.dump(messages.encode_dump_links())
        names = (attributes(link, HEADER.size + 16)[IFLA_IFNAME].rstrip(b"\0").decode() for link in links)
        return [name for name in names if name[0] in "pq"]

    def body() -> None:
        with running(plan(SegmentKind.RADIO, 3)):
            assert len(pair_interfaces()) == 12
        assert pair_interfaces() == []
        monkeypatch.setattr(tc, "add_clsact", lambda ifindex: messages.set_up(4711, up=True))
        with pytest.raises(MachineError, match=r"ingress of Far\(port=0\): the kernel refuses: No such device"):
            NetemEngine(plan(SegmentKind.RADIO, 4)).bring_up()
        assert pair_interfaces() == []

    in_lab(body)


def test_a_kernel_without_netem_is_refused_with_the_way_out(in_lab: Callable[[Callable[[], None]], None]) -> None:
    if features().netem_problem is None:
        pytest.skip("this kernel has sch_netem")

    def body() -> None:
        with pytest.raises(MachineError, match=r"no sch_netem; use `--engine air`"):
            NetemEngine(plan(SegmentKind.WIRE, 2)).bring_up()
        assert "no sch_netem" in (netem.why_not(plan(SegmentKind.WIRE, 2)) or "")

    in_lab(body)


def test_auto_is_told_what_netem_cannot_express() -> None:
    lab = plan(SegmentKind.WIRE, 2, Impairment(loss=PeriodicLoss(5)))
    assert "periodic loss" in (netem.why_not(lab) or "")


@pytest.mark.usefixtures("netem_kernel")
def test_delay_is_per_direction(in_lab: Callable[[Callable[[], None]], None]) -> None:
    def one_way_s(nodes: list[Node], sender: int, receiver: int) -> float:
        started = time.monotonic()
        nodes[sender].send(nodes[receiver].mac, b"x" * 60)
        nodes[receiver].sock.settimeout(5)
        nodes[receiver].sock.recv(2000)
        return time.monotonic() - started

    def body() -> None:
        with running(plan(SegmentKind.RADIO, 3)) as (engine, nodes):
            engine.set_pairs({(0, 1): Impairment(delay_s=0.05), (1, 0): Impairment(delay_s=0.15)})
            assert 0.05 <= one_way_s(nodes, 0, 1) < 0.1
            assert 0.15 <= one_way_s(nodes, 1, 0) < 0.2
            assert one_way_s(nodes, 0, 2) < 0.05

    in_lab(body)


@pytest.mark.usefixtures("netem_kernel")
def test_broadcast_losses_are_independent_for_each_receiver(in_lab: Callable[[Callable[[], None]], None]) -> None:
    def body() -> None:
        with running(plan(SegmentKind.RADIO, 4, Impairment(loss=RandomLoss(0.5)))) as (_, nodes):
            for number in range(400):
                nodes[0].send(BROADCAST, struct.pack("!H", number) + bytes(58))
                time.sleep(0)
            heard = [{payload[:2] for payload in node.received()} for node in nodes[1:]]
            for one in heard:
                assert 150 <= len(one) <= 250  # binomial, far beyond its 99.99 % interval
            assert 60 <= len(heard[0] & heard[1]) <= 140  # independent: a quarter hears both

    in_lab(body)


@pytest.mark.usefixtures("netem_kernel")
def test_outage_is_silent_and_frames_under_way_arrive(in_lab: Callable[[Callable[[], None]], None]) -> None:
    def body() -> None:
        with running(plan(SegmentKind.WIRE, 2, Impairment(delay_s=0.05))) as (engine, nodes):
            nodes[0].send(BROADCAST, b"before" + bytes(54))
            engine.set_outage({(0, 1)}, active=True)
            nodes[0].send(BROADCAST, b"during" + bytes(54))
            engine.set_outage({(0, 1)}, active=False)
            nodes[0].send(BROADCAST, b"after." + bytes(54))
            assert [payload[:6] for payload in nodes[1].received(0.3)] == [b"before", b"after."]
            engine.set_pairs({(0, 1): None})
            assert who_gets(nodes, 0, BROADCAST) == []

    in_lab(body)
