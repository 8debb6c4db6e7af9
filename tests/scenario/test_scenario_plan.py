"""Scenario to plan: ports, addresses, pairs; the same every time, and fast."""

from hypothesis import given
from hypothesis import strategies as st

from netlab.engines.base import LabPlan
from netlab.engines.plan import compile_plan, hosts
from netlab.medium.impairments import (
    PERFECT,
    Distribution,
    FourStateLoss,
    GilbertElliottLoss,
    Impairment,
    PeriodicLoss,
    RandomLoss,
    TraceLoss,
)
from netlab.medium.segments import SegmentKind
from netlab.scenario import parse_scenario

ALL_RADIOS = {"propagation": {"model": "none"}}


def plan_of(**keys: object) -> LabPlan:
    return compile_plan(parse_scenario({"duration": "10s", "nodes": {"a": {}, "b": {}, "c": {}}, **keys}))


def one_wire(**words: object) -> Impairment:
    [segment] = plan_of(links=[{"between": ["a", "b"], **words}]).segments
    assert segment.pairs[0, 1] == segment.pairs[1, 0]
    return segment.pairs[0, 1]


def test_ports_are_numbered_node_by_node_with_addresses_by_link() -> None:
    plan = plan_of(links=[{"between": ["b", "a"]}, {"between": ["b", "c"]}], radio=ALL_RADIOS)
    assert [(port.index, port.node, port.ifname, port.address) for port in plan.ports] == [
        (0, "a", "eth0", "10.1.0.2/24"),
        (1, "a", "radio0", "10.200.0.1/16"),
        (2, "b", "eth0", "10.1.0.1/24"),
        (3, "b", "eth1", "10.1.1.1/24"),
        (4, "b", "radio0", "10.200.0.2/16"),
        (5, "c", "eth0", "10.1.1.2/24"),
        (6, "c", "radio0", "10.200.0.3/16"),
    ]
    assert [(s.name, s.kind, s.ports) for s in plan.segments] == [
        ("b-a", SegmentKind.WIRE, (2, 0)),
        ("b-c", SegmentKind.WIRE, (3, 5)),
        ("radio", SegmentKind.RADIO, (1, 4, 6)),
    ]


def test_macs_are_local_unicast_and_distinct() -> None:
    plan = plan_of(generate={"shape": "full", "count": 40})
    macs = [port.mac for port in plan.ports]
    assert all(mac[0] & 0b11 == 0b10 and len(mac) == 6 for mac in macs)
    assert len(set(macs)) == len(macs)


def test_hosts_name_the_first_port_and_every_interface() -> None:
    plan = plan_of(links=[{"between": ["a", "b"]}], radio=ALL_RADIOS)
    assert hosts(plan) == [
        ("10.1.0.1", "a"),
        ("10.1.0.1", "a-eth0"),
        ("10.200.0.1", "a-radio0"),
        ("10.1.0.2", "b"),
        ("10.1.0.2", "b-eth0"),
        ("10.200.0.2", "b-radio0"),
        ("10.200.0.3", "c"),
        ("10.200.0.3", "c-radio0"),
    ]


def test_a_link_without_words_is_perfect_and_limits_replace_each_other() -> None:
    assert one_wire() == PERFECT
    assert one_wire(limit=60) == Impairment(limit_packets=60)
    assert one_wire(limit="64kB") == Impairment(limit_packets=None, limit_bytes=64_000)


def test_every_word_arrives() -> None:
    assert one_wire(
        delay="20ms",
        jitter="2ms",
        delay_correlation="25%",
        distribution="normal",
        loss={"ratio": "1%", "correlation": "10%"},
        duplicate={"ratio": "2%", "correlation": "20%"},
        reorder={"ratio": "3%", "correlation": "30%", "gap": 5},
        corrupt="4%",
        rate="10mbit",
        limit=50,
    ) == Impairment(
        delay_s=0.02,
        jitter_s=0.002,
        delay_correlation=0.25,
        distribution=Distribution.NORMAL,
        loss=RandomLoss(0.01, 0.1),
        duplicate_ratio=0.02,
        duplicate_correlation=0.2,
        reorder_ratio=0.03,
        reorder_correlation=0.3,
        reorder_gap=5,
        corrupt_ratio=0.04,
        rate_bps=10e6,
        limit_packets=50,
    )


def test_loss_models_take_tcs_defaults() -> None:
    assert one_wire(loss={"gemodel": {"p": "25%"}}).loss == GilbertElliottLoss(0.25, 0.75, 1.0, 0.0)
    assert one_wire(loss={"gemodel": {"p": "1%", "r": "25%", "1-h": "80%", "1-k": "0.5%"}}).loss == GilbertElliottLoss(
        0.01, 0.25, 0.8, 0.005
    )
    assert one_wire(loss={"state": {"p13": "25%"}}).loss == FourStateLoss(0.25, 0.75, 0.0, 1.0, 0.0)
    assert one_wire(loss={"periodic": {"every": 10, "offset": 3}}).loss == PeriodicLoss(10, 3)
    assert one_wire(loss={"trace": [0, 1]}).loss == TraceLoss((False, True))
    assert one_wire(loss="0%").loss is None


def test_without_propagation_everyone_hears_everyone_but_those_who_opted_out() -> None:
    plan = plan_of(radio={**ALL_RADIOS, "delay": "1ms"}, nodes={"a": {}, "b": {"radio": "none"}, "c": {}, "d": {}})
    [segment] = plan.segments
    assert [plan.ports[index].node for index in segment.ports] == ["a", "c", "d"]
    assert set(segment.pairs) == {(x, y) for x in segment.ports for y in segment.ports if x != y}
    assert set(segment.pairs.values()) == {Impairment(delay_s=0.001)}


def test_a_table_lays_its_words_over_the_radios() -> None:
    plan = plan_of(
        radio={
            "rate": "6mbit",
            "loss": "1%",
            "propagation": {
                "model": "table",
                "pairs": [{"between": ["a", "b"], "loss": "5%"}, {"from": "b", "to": "c", "delay": "3ms"}],
            },
        }
    )
    [segment] = plan.segments
    assert segment.pairs == {
        (0, 1): Impairment(rate_bps=6e6, loss=RandomLoss(0.05)),
        (1, 0): Impairment(rate_bps=6e6, loss=RandomLoss(0.05)),
        (1, 2): Impairment(rate_bps=6e6, loss=RandomLoss(0.01), delay_s=0.003),
    }


def test_a_tables_default_covers_the_pairs_that_it_does_not_name() -> None:
    table = {"model": "table", "pairs": [{"between": ["a", "b"]}], "default": {"loss": "50%"}}
    [segment] = plan_of(radio={"propagation": table}).segments
    assert segment.pairs[0, 1] == PERFECT
    assert segment.pairs[0, 2] == segment.pairs[2, 1] == Impairment(loss=RandomLoss(0.5))


@given(st.sampled_from(["line", "star", "grid", "full"]), st.integers(2, 20), st.booleans())
def test_every_plan_holds_its_invariants_and_is_the_same_again(shape: str, count: int, radio: bool) -> None:
    keys = {"generate": {"shape": shape, "count": count, "link": {"delay": "1ms"}}}
    plan = plan_of(**keys, **({"radio": ALL_RADIOS} if radio else {}))
    assert plan == plan_of(**keys, **({"radio": ALL_RADIOS} if radio else {}))
    assert [port.index for port in plan.ports] == list(range(len(plan.ports)))
    assert len({port.address for port in plan.ports}) == len(plan.ports)
    assert len({(port.node, port.ifname) for port in plan.ports}) == len(plan.ports)
    assert sorted(index for segment in plan.segments for index in segment.ports) == list(range(len(plan.ports)))
    for segment in plan.segments:
        assert set(segment.pairs) <= {(x, y) for x in segment.ports for y in segment.ports if x != y}
