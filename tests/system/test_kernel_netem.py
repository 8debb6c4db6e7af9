"""The netem engine's devices and filters on a real kernel.

Where the kernel lacks sch_netem, the paths of frames are still tried: a plain FIFO then stands where netem would. The
tests of delay, loss and outage need sch_netem and are skipped without it.
"""

from __future__ import annotations

import struct
import time
from dataclasses import replace

import pytest
from pyroute2.netlink.rtnl.tcmsg import tcmsg

from netlab.engines import netem
from netlab.engines.netem import NetemEngine
from netlab.errors import MachineError
from netlab.kernel import messages, tc
from netlab.medium.impairments import Impairment, PeriodicLoss, RandomLoss
from netlab.medium.segments import SegmentKind
from tests.system.kernel_rig import BROADCAST, Node, in_lab, links_here, plan, running, tc_features, who_gets

UNKNOWN = bytes.fromhex("0200000000ff")
RTM_NEWQDISC = 36


def _fifo(ifindex: int, impairment: Impairment, *, seed: int) -> bytes:
    message = tcmsg()
    message["index"], message["handle"], message["parent"] = ifindex, 0x10000, 0xFFFFFFFF
    message["attrs"] = [("TCA_KIND", "pfifo")]
    return messages.encode_message(message, RTM_NEWQDISC, messages.NLM_F_CREATE | messages.NLM_F_EXCL)


@pytest.fixture(params=list(tc.Classifier))
def any_kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the engine come up with this classifier, with or without sch_netem."""
    found = tc_features()
    if request.param not in found.classifiers:
        pytest.skip(f"this kernel has no classifier {request.param}")
    monkeypatch.setattr(netem, "tc_features", lambda: replace(found, netem_problem=None, classifiers=(request.param,)))
    if found.netem_problem is not None:
        monkeypatch.setattr(tc, "add_netem", _fifo)


@pytest.mark.usefixtures("any_kernel")
@in_lab
def test_radio_frames_reach_who_should_hear_them() -> None:
    with running(plan(SegmentKind.RADIO, 4, monitor=3)) as (_, nodes):
        assert who_gets(nodes, 0, BROADCAST) == [1, 2, 3]
        assert who_gets(nodes, 0, bytes.fromhex("01005e000001")) == [1, 2, 3]
        assert who_gets(nodes, 0, nodes[1].mac) == [1, 3]
        assert who_gets(nodes, 1, nodes[3].mac) == [3]
        assert who_gets(nodes, 3, nodes[0].mac) == [0]
        assert who_gets(nodes, 0, UNKNOWN) == [3]


@pytest.mark.usefixtures("any_kernel")
@in_lab
def test_wires_carry_everything() -> None:
    with running(plan(SegmentKind.WIRE, 2)) as (engine, nodes):
        assert who_gets(nodes, 0, UNKNOWN) == [1]
        assert who_gets(nodes, 1, BROADCAST) == [0]
        engine.set_carrier({1}, up=False)
        assert who_gets(nodes, 0, BROADCAST) == []
        engine.set_carrier({1}, up=True)
        assert who_gets(nodes, 0, BROADCAST) == [1]
    with running(plan(SegmentKind.WIRE, 3)) as (_, nodes):
        assert who_gets(nodes, 2, UNKNOWN) == [0, 1]


@pytest.mark.usefixtures("any_kernel")
@in_lab
def test_more_receivers_than_one_filter_holds() -> None:
    count = tc.ACTIONS_MAX + 3
    with running(plan(SegmentKind.WIRE, count)) as (_, nodes):
        nodes[5].send(BROADCAST, b"x" * 60)
        assert [len(node.received(0.005)) for node in nodes] == [int(i != 5) for i in range(count)]


@pytest.mark.usefixtures("any_kernel")
@in_lab
def test_close_and_failure_leave_no_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    def pair_interfaces() -> list[str]:
        return [name for name in links_here() if name[0] in "pq"]

    with running(plan(SegmentKind.RADIO, 3)):
        assert len(pair_interfaces()) == 12
    assert pair_interfaces() == []
    monkeypatch.setattr(tc, "add_clsact", lambda ifindex: messages.set_up(4711, up=True))
    with pytest.raises(MachineError, match=r"ingress of Far\(port=0\): the kernel refuses: No such device"):
        NetemEngine(plan(SegmentKind.RADIO, 4)).bring_up()
    assert pair_interfaces() == []


@pytest.mark.usefixtures("no_netem_kernel")
@in_lab
def test_a_kernel_without_netem_is_refused_with_the_way_out() -> None:
    with pytest.raises(MachineError, match=r"no sch_netem; use `--engine air`"):
        NetemEngine(plan(SegmentKind.WIRE, 2)).bring_up()
    assert "no sch_netem" in (netem.why_not(plan(SegmentKind.WIRE, 2)) or "")


def test_auto_is_told_what_netem_cannot_express() -> None:
    lab = plan(SegmentKind.WIRE, 2, Impairment(loss=PeriodicLoss(5)))
    assert "periodic loss" in (netem.why_not(lab) or "")


@pytest.mark.usefixtures("netem_kernel")
@in_lab
def test_delay_is_per_direction() -> None:
    def one_way_s(nodes: list[Node], sender: int, receiver: int) -> float:
        started = time.monotonic()
        nodes[sender].send(nodes[receiver].mac, b"x" * 60)
        nodes[receiver].sock.settimeout(5)
        nodes[receiver].sock.recv(2000)
        return time.monotonic() - started

    with running(plan(SegmentKind.RADIO, 3)) as (engine, nodes):
        engine.set_pairs({(0, 1): Impairment(delay_s=0.05), (1, 0): Impairment(delay_s=0.15)})
        assert 0.05 <= one_way_s(nodes, 0, 1) < 0.1
        assert 0.15 <= one_way_s(nodes, 1, 0) < 0.2
        assert one_way_s(nodes, 0, 2) < 0.05


@pytest.mark.usefixtures("netem_kernel")
@in_lab
def test_broadcast_losses_are_independent_for_each_receiver() -> None:
    with running(plan(SegmentKind.RADIO, 4, Impairment(loss=RandomLoss(0.5)))) as (_, nodes):
        for number in range(400):
            nodes[0].send(BROADCAST, struct.pack("!H", number) + bytes(58))
            time.sleep(0)
        heard = [{payload[:2] for payload in node.received()} for node in nodes[1:]]
        for one in heard:
            assert 150 <= len(one) <= 250  # binomial, far beyond its 99.99 % interval
        assert 60 <= len(heard[0] & heard[1]) <= 140  # independent: a quarter hears both


@pytest.mark.usefixtures("netem_kernel")
@in_lab
def test_outage_is_silent_and_frames_under_way_arrive() -> None:
    with running(plan(SegmentKind.WIRE, 2, Impairment(delay_s=0.05))) as (engine, nodes):
        nodes[0].send(BROADCAST, b"before" + bytes(54))
        engine.set_outage({(0, 1)}, active=True)
        nodes[0].send(BROADCAST, b"during" + bytes(54))
        engine.set_outage({(0, 1)}, active=False)
        nodes[0].send(BROADCAST, b"after." + bytes(54))
        assert [payload[:6] for payload in nodes[1].received(0.3)] == [b"before", b"after."]
        engine.set_pairs({(0, 1): None})
        assert who_gets(nodes, 0, BROADCAST) == []
