"""Frames that found a full queue are told from those that the loss model took; on a kernel that has netem."""

from __future__ import annotations

import subprocess

import pytest

from netlab.engines.base import PairCounters
from netlab.engines.netem import NetemEngine
from netlab.medium.impairments import Impairment, RandomLoss
from netlab.medium.segments import SegmentKind
from tests.system.kernel_rig import BROADCAST, Node, in_lab, plan, running, visiting

pytestmark = pytest.mark.usefixtures("netem_kernel")

FRAMES = 400
NARROW = Impairment(delay_s=0.2, limit_packets=100)
LOSSY = Impairment(delay_s=0.2, limit_packets=100, loss=RandomLoss(0.3))
LOST = range(83, 158)  # binomial(400, 0.3), beyond its 99.99 % interval


class Counted:
    """Counts of the pair from n0 to n1 since everything that the nodes sent at their start has arrived."""

    def __init__(self, engine: NetemEngine, nodes: list[Node]) -> None:
        self._engine = engine
        nodes[1].received(0.5)
        self._first = engine.pair_counters()[0, 1]
        assert self._first.waiting == 0

    def __call__(self) -> PairCounters:
        now = self._engine.pair_counters()[0, 1]
        assert now.queue_full is not None
        assert self._first.queue_full is not None
        return PairCounters(now.queue_full - self._first.queue_full, now.waiting, now.reordered - self._first.reordered)


@pytest.mark.parametrize("kind", list(SegmentKind))
@pytest.mark.parametrize("count", [2, 3])
@in_lab
def test_a_burst_fills_the_queue_and_the_rest_is_counted(kind: SegmentKind, count: int) -> None:
    with running(plan(kind, count, NARROW)) as (engine, nodes):
        counted = Counted(engine, nodes)
        nodes[0].burst(BROADCAST, FRAMES)
        assert counted() == PairCounters(queue_full=300, waiting=100, reordered=0)
        assert len(nodes[1].received(0.3)) == 100
        assert counted() == PairCounters(queue_full=300, waiting=0, reordered=0)


@pytest.mark.parametrize("count", [2, 3])
@in_lab
def test_losses_are_no_full_queues(count: int) -> None:
    with running(plan(SegmentKind.RADIO, count, LOSSY)) as (engine, nodes):
        counted = Counted(engine, nodes)
        nodes[0].burst(BROADCAST, FRAMES)
        full = counted().queue_full
        assert full is not None
        arrived = len(nodes[1].received(0.3))
        assert arrived == 100
        assert FRAMES - arrived - full in LOST
        engine.set_outage({(0, 1)}, active=True)
        nodes[0].burst(BROADCAST, FRAMES)
        assert counted().queue_full == full


@in_lab
def test_frames_that_overtake_are_counted() -> None:
    overtaking = Impairment(delay_s=0.05, reorder_ratio=0.25)
    with running(plan(SegmentKind.WIRE, 2, overtaking)) as (engine, nodes):
        counted = Counted(engine, nodes)
        nodes[0].burst(BROADCAST, FRAMES, every_s=0.0005)
        early = sum(delay_s < 0.04 for _, delay_s, _ in nodes[1].arrivals())
        assert 60 <= early <= 140
        assert counted().reordered == early


@in_lab
def test_a_pulled_cable_is_no_full_queue() -> None:
    def burst(nodes: list[Node]) -> None:
        nodes[0].burst(BROADCAST, 150)
        nodes[1].received(0.3)

    with running(plan(SegmentKind.WIRE, 2, NARROW)) as (engine, nodes):
        counted = Counted(engine, nodes)
        burst(nodes)
        assert counted().queue_full == 50
        engine.set_carrier({1}, up=False)
        burst(nodes)
        assert counted().queue_full == 50
        engine.set_carrier({1}, up=True)
        burst(nodes)
        assert counted().queue_full == 100


@in_lab
def test_where_a_node_has_taken_its_interface_down_nothing_is_claimed() -> None:
    def switch(engine: NetemEngine, state: str) -> None:
        with visiting(engine.namespace_fds["n1"]):
            subprocess.run(["/sbin/ip", "link", "set", "radio0", state], check=True)

    with running(plan(SegmentKind.WIRE, 2, LOSSY)) as (engine, nodes):
        nodes[0].burst(BROADCAST, 20)
        switch(engine, "down")
        nodes[0].burst(BROADCAST, 5)
        switch(engine, "up")
        assert engine.pair_counters()[0, 1].queue_full is None
