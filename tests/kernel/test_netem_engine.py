"""The engine tells the kernel what changed, once; a fake kernel notes the orders."""

from __future__ import annotations

import errno
import struct
from dataclasses import dataclass, field

import pytest

from netlab.engines import netem, netem_counters
from netlab.engines.base import Engine, LabPlan, Pair, PairCounters
from netlab.engines.netem import NetemEngine, choose_classifier
from netlab.errors import MachineError
from netlab.kernel import pairs
from netlab.kernel.counters import QdiscCounters
from netlab.kernel.netlink import NetlinkError, attributes
from netlab.kernel.pairs import Pairs
from netlab.kernel.probe import TcFeatures
from netlab.kernel.tc import Classifier
from netlab.kernel.wiring import VethSpec
from netlab.medium.impairments import PERFECT, Distribution, Impairment, PeriodicLoss, RandomLoss
from netlab.medium.segments import Port, Segment, SegmentKind

DELAYED = Impairment(delay_s=0.02)
NORMAL = Impairment(delay_s=0.02, jitter_s=0.002, distribution=Distribution.NORMAL)
UNIFORM = Impairment(delay_s=0.02, jitter_s=0.002)
ALL = 0xFFFFFFFF
RTM_NEWQDISC, RTM_NEWTFILTER = 36, 44
DELAY_DIST, LATENCY64, PRNG_SEED = 2, 10, 14


@dataclass
class Kernel:
    """Stands in for the socket, the wiring and the pairs' veths."""

    batches: list[list[bytes]] = field(default_factory=list)
    deleted_groups: list[int] = field(default_factory=list)
    closed: int = 0
    refuse: int | None = None  # the position of a message that every batch with so many messages gets refused
    reason: int = errno.EINVAL
    refusals: dict[int, int] = field(default_factory=dict)  # by interface index, as the kernel counts them
    carrier_losses: dict[int, int] = field(default_factory=dict)
    qdiscs: dict[int, QdiscCounters] = field(default_factory=dict)

    def request(self, orders: list[bytes]) -> None:
        self.batches.append(orders)
        if self.refuse is not None and self.refuse < len(orders):
            raise NetlinkError(self.reason, self.refuse, "the kernel's own words.")

    def close(self) -> None:
        self.closed += 1

    def orders(self) -> list[tuple[int, int]]:
        return [struct.unpack_from("=4xH14xI", order) for batch in self.batches for order in batch]


@dataclass
class FakeWiring:
    kernel: Kernel
    peer_ifindex: tuple[int, ...]
    namespace_fds: dict[str, int]
    carrier: list[tuple[list[int], bool]] = field(default_factory=list)
    refuses: bool = False

    def set_peers(self, indices: list[int], *, up: bool) -> None:
        self.carrier.append((indices, up))
        if self.refuses and len(indices) > 1:
            raise OSError(errno.ENODEV, "far end far1: No such device")

    def close(self) -> None:
        self.kernel.closed += 1


def plan(count: int = 2, impairment: Impairment = DELAYED) -> LabPlan:
    ports = tuple(Port(i, f"n{i}", "eth0", bytes([2, 0, 0, 0, 0, i]), None) for i in range(count))
    every = {(i, j): impairment for i in range(count) for j in range(count) if i != j}
    segment = Segment("s", SegmentKind.RADIO, tuple(range(count)), every)
    return LabPlan("lab", 7, tuple(port.node for port in ports), ports, (segment,))


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    fake = Kernel()

    def build(nodes: tuple[str, ...], veths: list[VethSpec]) -> FakeWiring:
        return FakeWiring(fake, tuple(range(1000, 1000 + len(veths))), dict.fromkeys(nodes, 5))

    def create(sock: Kernel, ifnames: list[tuple[str, str]]) -> Pairs:
        assert all(len(name) <= 15 for names in ifnames for name in names)
        return Pairs(tuple((2000 + 2 * n, 2001 + 2 * n) for n in range(len(ifnames))), 2000 if ifnames else 0)

    monkeypatch.setattr(netem, "NetlinkSocket", lambda: fake)
    monkeypatch.setattr(netem, "build", build)
    monkeypatch.setattr(netem, "tc_features", lambda: TcFeatures(None, (Classifier.FLOWER, Classifier.U32), True))
    monkeypatch.setattr(pairs, "create", create)
    monkeypatch.setattr(netem_counters, "mirred_refusals", lambda sock: dict(fake.refusals))
    monkeypatch.setattr(netem_counters, "carrier_losses", lambda sock: dict(fake.carrier_losses))
    monkeypatch.setattr(netem_counters, "root_qdiscs", lambda sock: dict(fake.qdiscs))
    monkeypatch.setattr(netem, "delete_group", lambda sock, group: fake.deleted_groups.append(group))
    return fake


def up(kernel: Kernel, lab: LabPlan) -> NetemEngine:
    engine = NetemEngine(lab)
    engine.bring_up()
    kernel.batches.clear()
    return engine


def delay_ns(order: bytes) -> int:
    return int.from_bytes(options(order)[1][LATENCY64], "little")


def options(order: bytes) -> tuple[tuple[int, ...], dict[int, bytes]]:
    payload = attributes(order, 36)[2]
    return struct.unpack("=6I", payload[:24]), attributes(payload, 24)


def test_bring_up_is_one_batch_with_a_qdisc_per_pair_and_filters_at_every_ingress(kernel: Kernel) -> None:
    NetemEngine(plan(3)).bring_up()
    assert len(kernel.batches) == 1
    orders = kernel.orders()
    assert sum(kind == RTM_NEWQDISC for kind, _ in orders) == 6 + 3 + 6  # netem, clsact at far ends, at exits
    netems = [index for kind, index in orders[:6]]
    assert netems == [2000, 2002, 2004, 2006, 2008, 2010]
    assert sum(kind == RTM_NEWTFILTER for kind, _ in orders) == 3 * (1 + 2) + 6


def test_it_is_an_engine_and_tells_how_long_it_took(kernel: Kernel) -> None:
    engine: Engine = NetemEngine(plan(2))  # the type checker's test
    assert 0 <= engine.bring_up() < 60
    assert engine.problem() is None
    assert sorted(engine.namespace_fds) == ["n0", "n1"]


def test_two_ports_are_shaped_at_the_receivers_far_end(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    engine.set_pairs({(0, 1): PERFECT})
    assert kernel.orders() == [(RTM_NEWQDISC, 1001)]


def test_changes_go_in_one_batch_and_what_is_in_force_is_not_sent_again(kernel: Kernel) -> None:
    engine = up(kernel, plan(3))
    engine.set_pairs({(0, 1): PERFECT, (0, 2): DELAYED, (1, 0): Impairment(rate_bps=1e6)})
    assert [len(batch) for batch in kernel.batches] == [2]
    engine.set_pairs({(0, 1): PERFECT})
    assert [len(batch) for batch in kernel.batches if batch] == [2]


def test_every_change_has_another_seed(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    for n in range(4):
        engine.set_pairs({(0, 1): Impairment(delay_s=0.01 * n)})
    seeds = {options(batch[0])[1][PRNG_SEED] for batch in kernel.batches}
    assert len(seeds) == 4


def test_outage_loses_all_and_comes_back_to_what_was_set_meanwhile(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    engine.set_outage({(0, 1), (1, 0)}, active=True)
    assert [options(order)[0][2] for order in kernel.batches[-1]] == [ALL, ALL]
    engine.set_pairs({(0, 1): Impairment(loss=RandomLoss(0.5))})
    assert options(kernel.batches[-1][0])[0][2] == ALL
    engine.set_outage({(0, 1)}, active=False)
    assert [options(order)[0][2] for order in kernel.batches[-1]] == [0x80000000]


def test_out_of_range_loses_all_until_it_is_in_range_again(kernel: Kernel) -> None:
    engine = up(kernel, plan(3))
    engine.set_pairs({(0, 1): None})
    assert options(kernel.batches[-1][0])[0][2] == ALL
    engine.set_pairs({(0, 1): DELAYED})
    assert options(kernel.batches[-1][0])[0][2] == 0


def test_a_delay_table_is_replaced_when_the_jitter_becomes_uniform(kernel: Kernel) -> None:
    engine = up(kernel, plan(2, NORMAL))
    engine.set_pairs({(0, 1): UNIFORM})
    assert len(options(kernel.batches[-1][0])[1][DELAY_DIST]) == 8192
    fresh = up(kernel, plan(2, DELAYED))
    fresh.set_pairs({(0, 1): UNIFORM})
    assert DELAY_DIST not in options(kernel.batches[-1][0])[1]


def test_a_refused_change_leaves_every_pair_as_it_was(kernel: Kernel) -> None:
    engine = up(kernel, plan(3))
    kernel.refuse = 1
    wanted: dict[Pair, Impairment | None] = {
        (0, 1): PERFECT,
        (0, 2): Impairment(delay_s=0.5),
        (1, 0): PERFECT,
        (1, 2): DELAYED,
    }
    with pytest.raises(MachineError) as caught:
        engine.set_pairs(wanted)
    assert "netem for n0 eth0 -> n2 eth0 (link s): the kernel refuses" in str(caught.value)
    assert "the kernel's own words" in str(caught.value)
    assert str(caught.value).endswith("`--engine air`, which needs no kernel support; nothing has been changed")
    changed, *restored = kernel.batches
    assert len(changed) == 3
    # The refused one, too: the kernel sets delay and loss before it refuses.
    assert [delay_ns(order) for batch in restored for order in batch] == [20_000_000] * 3
    assert sorted(kernel.orders()[3:]) == sorted(kernel.orders()[:3])  # the same interfaces
    kernel.refuse = None
    kernel.batches.clear()
    former: dict[Pair, Impairment | None] = dict.fromkeys(wanted, DELAYED)
    engine.set_pairs(former)
    assert kernel.orders() == []  # all is so already
    engine.set_pairs(wanted)
    assert len(kernel.orders()) == 3


def test_a_refused_outage_is_none(kernel: Kernel) -> None:
    engine = up(kernel, plan(3))
    kernel.refuse = 1
    with pytest.raises(MachineError, match="nothing has been changed"):
        engine.set_outage({(0, 1), (1, 0)}, active=True)
    kernel.refuse = None
    engine.set_pairs({(0, 1): Impairment(loss=RandomLoss(0.5))})
    assert options(kernel.batches[-1][0])[0][2] == 0x80000000


def test_what_cannot_be_restored_is_named_and_told_again(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    kernel.refuse, kernel.reason = 0, errno.ENODEV
    with pytest.raises(MachineError, match=r"start it again; nothing .* but at n0 eth0 -> n1 eth0, whose state is un"):
        engine.set_pairs({(0, 1): PERFECT})
    kernel.refuse = None
    engine.set_pairs({(0, 1): DELAYED})
    assert len(kernel.batches[-1]) == 1


def test_a_table_that_a_refused_change_may_have_left_is_replaced(kernel: Kernel) -> None:
    engine = up(kernel, plan(2, UNIFORM))
    kernel.refuse = 1
    with pytest.raises(MachineError):
        engine.set_pairs({(0, 1): NORMAL, (1, 0): NORMAL})
    assert [DELAY_DIST in options(batch[0])[1] for batch in kernel.batches[1:]] == [True, True]


def test_lost_answers_are_told_and_everything_is_set_back(kernel: Kernel, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = up(kernel, plan(2))
    told: list[int] = []

    def request(orders: list[bytes]) -> None:
        told.extend(map(delay_ns, orders))
        if len(told) == 1:
            raise OSError(errno.ENOBUFS, "No buffer space available")

    monkeypatch.setattr(kernel, "request", request)
    with pytest.raises(MachineError, match=r"answers were lost.*No buffer space.*nothing has been changed"):
        engine.set_pairs({(0, 1): PERFECT})
    assert told == [0, 20_000_000]


def test_half_way_failure_removes_everything(kernel: Kernel) -> None:
    kernel.refuse = 3
    engine = NetemEngine(plan(3))
    with pytest.raises(MachineError, match="the kernel refuses: Invalid argument"):
        engine.bring_up()
    assert kernel.deleted_groups == [2000]
    assert kernel.closed == 2  # socket and wiring


def test_no_interface_has_two_netems(kernel: Kernel) -> None:
    """Some kernels since 2025 refuse to duplicate where the interface has another netem."""
    for count in (2, 4):
        kernel.batches.clear()
        NetemEngine(plan(count, Impairment(duplicate_ratio=0.1))).bring_up()
        shaped = [
            index
            for (kind, index), order in zip(kernel.orders(), kernel.batches[0], strict=True)
            if kind == RTM_NEWQDISC and b"netem" in order
        ]
        assert len(shaped) == len(set(shaped)) == count * (count - 1)


def test_inexpressible_impairments_are_refused_before_anything_is_done(kernel: Kernel) -> None:
    with pytest.raises(MachineError, match=r"--engine air.*\n.*periodic loss"):
        NetemEngine(plan(2, Impairment(loss=PeriodicLoss(2))))
    engine = up(kernel, plan(2))
    with pytest.raises(MachineError, match="queue limit in bytes"):
        engine.set_pairs({(0, 1): PERFECT, (1, 0): Impairment(limit_bytes=1000)})
    assert kernel.batches == []


def test_unknown_pairs_are_refused(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    with pytest.raises(ValueError, match=r"\(0, 9\)"):
        engine.set_outage({(0, 9)}, active=True)


def test_carrier_goes_to_the_far_ends(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    engine.set_carrier({1, 0}, up=False)
    wiring = engine._wiring
    assert isinstance(wiring, FakeWiring)
    assert wiring.carrier == [([0, 1], False)]


def test_a_cable_is_pulled_once_and_a_refusal_pulls_none(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    wiring = engine._wiring
    assert isinstance(wiring, FakeWiring)
    wiring.refuses = True
    with pytest.raises(MachineError, match=r"carrier of n0 eth0, n1 eth0: .*far1.*; nothing has been changed"):
        engine.set_carrier({0, 1}, up=False)
    assert wiring.carrier == [([0, 1], False), ([0], True), ([1], True)]
    wiring.refuses = False
    engine.set_carrier({0}, up=False)
    engine.set_carrier({0, 1}, up=False)
    assert wiring.carrier[3:] == [([0], False), ([1], False)]


def drops(count: int, waiting: int = 0, requeues: int = 0) -> QdiscCounters:
    return QdiscCounters("netem", waiting=waiting, drops=count, requeues=requeues)


def test_full_queues_are_what_the_filter_could_not_hand_on(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    kernel.refusals, kernel.qdiscs = {1001: 7, 1000: 0}, {1001: drops(30, 4, 2), 1000: drops(9)}
    assert engine.pair_counters() == {(0, 1): PairCounters(7, 4, 2), (1, 0): PairCounters(0, 0, 0)}


def test_what_met_a_pulled_cable_is_no_full_queue(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    kernel.refusals, kernel.qdiscs = {1001: 5}, {1001: drops(30)}
    engine.set_carrier({1}, up=False)
    kernel.refusals, kernel.carrier_losses = {1001: 25}, {1001: 1}
    assert engine.pair_counters()[0, 1].queue_full == 5
    engine.set_carrier({1}, up=True)
    kernel.refusals = {1001: 26}
    assert engine.pair_counters()[0, 1].queue_full == 6


def test_a_carrier_that_the_node_took_makes_the_count_uncertain(kernel: Kernel) -> None:
    engine = up(kernel, plan(2))
    kernel.refusals, kernel.qdiscs, kernel.carrier_losses = {1001: 5}, {1001: drops(30)}, {1001: 1}
    assert engine.pair_counters()[0, 1].queue_full is None
    kernel.qdiscs = {}
    assert engine.pair_counters()[0, 1].queue_full == 0  # netem has dropped nothing at all
    kernel.qdiscs, kernel.carrier_losses = {1001: drops(3)}, {}
    assert engine.pair_counters()[0, 1].queue_full is None  # more than netem has dropped


def test_close_twice_is_harmless(kernel: Kernel) -> None:
    engine = up(kernel, plan(3))
    engine.close()
    engine.close()
    assert kernel.deleted_groups == [2000]
    with pytest.raises(RuntimeError, match="not up"):
        engine.set_pairs({(0, 1): PERFECT})


def test_without_netem_or_classifier_the_way_out_is_named() -> None:
    with pytest.raises(MachineError, match=r"this kernel has no sch_netem; use `--engine air`"):
        choose_classifier(TcFeatures("this kernel has no sch_netem", (Classifier.U32,), True))
    with pytest.raises(MachineError, match="neither cls_flower nor cls_u32"):
        choose_classifier(TcFeatures(None, (), True))
    assert choose_classifier(TcFeatures(None, (Classifier.U32,), False)) is Classifier.U32
