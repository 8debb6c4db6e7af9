"""A lab's plan becomes devices, filters and qdiscs: who hears whom, and by which path."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from netlab.engines.base import LabPlan, Pair
from netlab.engines.netem_plan import (
    OUT_OF_RANGE,
    Device,
    Entry,
    Exit,
    Far,
    NetemPlan,
    compile_plan,
    effective,
    pair_seed,
    problems,
    warnings,
)
from netlab.kernel.tc import ACTIONS_MAX
from netlab.medium.impairments import PERFECT, GilbertElliottLoss, Impairment, PeriodicLoss, RandomLoss
from netlab.medium.segments import Port, Segment, SegmentKind

BROADCAST = b"\xff" * 6
MULTICAST = bytes.fromhex("01005e000001")
UNKNOWN = bytes.fromhex("0200000000ff")


def mac(port: int) -> bytes:
    return bytes.fromhex("02000000") + port.to_bytes(2, "big")


def lab(kind: SegmentKind, count: int, monitors: frozenset[int] = frozenset(), loners: int = 0) -> LabPlan:
    total = count + loners
    ports = tuple(Port(i, f"n{i}", "eth0", mac(i), f"10.0.0.{i + 1}/24", monitor=i in monitors) for i in range(total))
    pairs = {(i, j): PERFECT for i in range(count) for j in range(count) if i != j}
    segment = Segment("s", kind, tuple(range(count)), pairs)
    return LabPlan("lab", 7, tuple(port.node for port in ports), ports, (segment,))


def hears(plan: NetemPlan, sender: int, destination: bytes) -> list[int]:
    """Follow a frame through the rules as the kernel would; the ports whose nodes get it, with repetitions."""
    return sorted(_arrivals(plan, Far(sender), destination))


def _arrivals(plan: NetemPlan, device: Device, destination: bytes) -> list[int]:
    found: list[int] = []
    for rule in sorted((r for r in plan.rules if r.device == device), key=lambda r: r.priority):
        masked = bytes(a & b for a, b in zip(destination, rule.match.mask, strict=True))
        if masked != rule.match.value:
            continue
        for target in rule.targets:
            # Out of Far(j) is into the node; out of an Entry is into its Exit.
            leaves = isinstance(target, Far)
            found += [target.port] if isinstance(target, Far) else []
            assert leaves or isinstance(target, Entry)
            if isinstance(target, Entry):
                found += _arrivals(plan, Exit(target.pair), destination)
        if rule.last:
            return found
    assert found == [], f"{destination.hex()} at {device} was copied and then given to the lab's own stack as well"
    return []


@pytest.mark.parametrize("kind", list(SegmentKind))
def test_two_ports_need_no_device_between_them(kind: SegmentKind) -> None:
    plan = compile_plan(lab(kind, 2))
    assert plan.pair_veths == ()
    assert plan.shapes == {(0, 1): Far(1), (1, 0): Far(0)}
    assert hears(plan, 0, BROADCAST) == [1]
    assert hears(plan, 0, mac(1)) == [1]


def test_each_directed_pair_of_a_larger_segment_has_its_own_queue() -> None:
    plan = compile_plan(lab(SegmentKind.RADIO, 4))
    assert len(plan.pair_veths) == len(set(plan.shapes.values())) == 12
    assert all(plan.shapes[pair] == Entry(pair) for pair in plan.pair_veths)


def test_radio_group_frames_reach_all_and_unicast_its_addressee() -> None:
    plan = compile_plan(lab(SegmentKind.RADIO, 4))
    assert hears(plan, 1, BROADCAST) == hears(plan, 1, MULTICAST) == [0, 2, 3]
    assert hears(plan, 1, mac(3)) == [3]
    assert hears(plan, 1, UNKNOWN) == []


def test_monitor_hears_unicast_for_others_once_and_its_own_once() -> None:
    plan = compile_plan(lab(SegmentKind.RADIO, 4, monitors=frozenset({2})))
    assert hears(plan, 0, mac(1)) == [1, 2]
    assert hears(plan, 0, mac(2)) == [2]
    assert hears(plan, 0, UNKNOWN) == [2]
    assert hears(plan, 2, mac(1)) == [1]


def test_wire_carries_everything_to_everybody() -> None:
    plan = compile_plan(lab(SegmentKind.WIRE, 3))
    for destination in (BROADCAST, mac(1), UNKNOWN):
        assert hears(plan, 0, destination) == [1, 2]


@settings(deadline=None)  # a busy machine is no failure
@given(st.integers(2, 8) | st.just(ACTIONS_MAX + 3), st.sampled_from(SegmentKind), st.data())
def test_nobody_hears_itself_or_a_frame_twice(count: int, kind: SegmentKind, data: st.DataObject) -> None:
    monitors = frozenset(data.draw(st.sets(st.integers(0, count - 1), max_size=count)))
    plan = compile_plan(lab(kind, count, monitors))
    sender = data.draw(st.integers(0, count - 1))
    others = [port for port in range(count) if port != sender]
    assert hears(plan, sender, BROADCAST) == others
    addressee = data.draw(st.sampled_from(others))
    expected = others if kind is SegmentKind.WIRE else sorted({addressee, *monitors} - {sender})
    assert hears(plan, sender, mac(addressee)) == expected
    rules = [(rule.device, rule.priority) for rule in plan.rules]
    assert len(set(rules)) == len(rules)
    assert all(1 <= len(rule.targets) <= ACTIONS_MAX for rule in plan.rules)


def test_a_port_without_a_segment_is_heard_by_nobody() -> None:
    plan = compile_plan(lab(SegmentKind.RADIO, 3, loners=1))
    assert hears(plan, 3, BROADCAST) == []


def test_missing_pairs_have_a_queue_that_loses_everything() -> None:
    base = lab(SegmentKind.RADIO, 3)
    only = Segment("s", SegmentKind.RADIO, (0, 1, 2), {(0, 1): PERFECT})
    plan = compile_plan(LabPlan("lab", 7, base.nodes, base.ports, (only,)))
    assert len(plan.shapes) == 6
    assert {pair for pair, impairment in plan.impairments.items() if impairment is None} == set(plan.shapes) - {(0, 1)}
    assert effective(None, outage=False) == OUT_OF_RANGE
    assert OUT_OF_RANGE.loss == RandomLoss(1.0)


def test_outage_replaces_the_loss_and_nothing_else() -> None:
    bad = Impairment(delay_s=0.02, rate_bps=1e6, limit_packets=7, loss=GilbertElliottLoss(0.1, 0.2))
    cut = effective(bad, outage=True)
    assert cut.loss == RandomLoss(1.0)
    assert (cut.delay_s, cut.rate_bps, cut.limit_packets) == (0.02, 1e6, 7)
    assert effective(bad, outage=False) == bad


def _with(pairs: Mapping[Pair, Impairment]) -> LabPlan:
    base = lab(SegmentKind.WIRE, 2)
    return LabPlan("lab", 7, base.nodes, base.ports, (Segment("s", SegmentKind.WIRE, (0, 1), dict(pairs)),))


def test_what_netem_cannot_do_is_named_with_its_pair() -> None:
    assert problems(_with({(0, 1): PERFECT, (1, 0): Impairment(loss=PeriodicLoss(3))})) == [
        "n1 eth0 -> n0 eth0: periodic loss"
    ]
    assert problems(_with({(0, 1): PERFECT})) == []


def test_narrow_limits_are_pointed_out_with_their_pair() -> None:
    (text,) = warnings(_with({(0, 1): Impairment(rate_bps=1e9, delay_s=0.5)}))
    assert text.startswith("n0 eth0 -> n1 eth0: limit 1000 packets")


@pytest.mark.parametrize(
    "segments",
    [
        (Segment("a", SegmentKind.WIRE, (0, 1), {}), Segment("b", SegmentKind.WIRE, (1, 2), {})),
        (Segment("a", SegmentKind.WIRE, (0, 0), {}),),
        (Segment("a", SegmentKind.WIRE, (0, 1), {(0, 2): PERFECT}),),
        (Segment("a", SegmentKind.WIRE, (0, 1), {(1, 1): PERFECT}),),
    ],
)
def test_impossible_plans_are_refused(segments: tuple[Segment, ...]) -> None:
    base = lab(SegmentKind.WIRE, 3)
    with pytest.raises(ValueError, match=r"segment [ab]: "):
        compile_plan(LabPlan("lab", 7, base.nodes, base.ports, segments))


def test_seeds_differ_by_pair_direction_and_change_but_not_by_run() -> None:
    seeds = {pair_seed(7, pair, n) for pair in ((0, 1), (1, 0), (0, 2)) for n in range(50)}
    assert len(seeds) == 150
    assert pair_seed(7, (0, 1), 0) == pair_seed(7, (0, 1), 0) == 9747509991848476854
    assert pair_seed(8, (0, 1), 0) != pair_seed(7, (0, 1), 0)
