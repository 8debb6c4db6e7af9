"""Cuts and endings in a mesh: who still has a path, who has one again."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

from netlab.engines.plan import compile_plan
from netlab.scenario import parse_scenario
from netlab.timeline import Entry, Kind, MeshRoutes, compile_timeline

DIAMOND = [("a", "r"), ("r", "b"), ("a", "s"), ("s", "b")]
A_B = (("a", "b"),)


def timeline(*events: dict[str, object], **keys: object) -> tuple[Entry, ...]:
    node = {"processes": ["udp_mesh"]}
    scenario = parse_scenario(
        {
            "duration": "60s",
            "mesh": "batman-adv",
            "nodes": dict.fromkeys("arsb", node),
            "links": [{"between": list(ends)} for ends in DIAMOND],
            "traffic": [{"from": "b", "to": "a", "topic": "t", "size": "100B", "rate": "1Hz"}],
            "events": list(events),
            **keys,
        }
    )
    return compile_timeline(scenario, compile_plan(scenario))


def outage(at: int, length: int, a: str, b: str, **keys: object) -> dict[str, object]:
    return {"at": f"{at}s", "outage": {"between": [a, b], "for": f"{length}s", **keys}}


def marks(entries: tuple[Entry, ...]) -> list[tuple[float, str, object, object]]:
    return [(entry.at_s, entry.label, entry.reroutes, entry.rejoins) for entry in entries]


def test_a_cut_that_leaves_a_path_is_a_reroute_and_its_end_restores_nothing() -> None:
    entries = timeline(outage(5, 10, "r", "b"))
    assert marks(entries) == [(5.0, "outage r-b begins", A_B, ()), (15.0, "outage r-b ends", (), ())]
    assert [entry.restores for entry in entries] == [None, None]


def test_cuts_of_one_moment_count_together() -> None:
    entries = timeline(outage(5, 15, "r", "b"), outage(5, 20, "s", "b"))
    assert marks(entries) == [
        (5.0, "outage r-b begins", (), ()),
        (5.0, "outage s-b begins", (), ()),
        (20.0, "outage r-b ends", (), A_B),
        (25.0, "outage s-b ends", (), ()),
    ]


def test_the_second_cut_severs_and_is_no_reroute() -> None:
    entries = timeline(outage(5, 20, "r", "b"), outage(10, 5, "a", "s"))
    assert [(entry.at_s, bool(entry.reroutes), bool(entry.rejoins)) for entry in entries] == [
        (5.0, True, False),
        (10.0, False, False),
        (15.0, False, True),
        (25.0, False, False),
    ]


def test_a_swap_in_one_moment_is_a_reroute() -> None:
    swap = timeline(outage(5, 5, "r", "b"), outage(10, 5, "s", "b"))
    assert [(entry.label, bool(entry.reroutes)) for entry in swap if entry.at_s == 10.0] == [
        ("outage s-b begins", True),
        ("outage r-b ends", False),
    ]


def test_a_cut_in_the_moment_that_joins_again_is_no_reroute() -> None:
    entries = timeline(outage(5, 10, "r", "b"), outage(5, 20, "s", "b"), outage(15, 2, "a", "s"))
    assert [(entry.label, entry.reroutes, entry.rejoins) for entry in entries if entry.at_s == 15.0] == [
        ("outage a-s begins", (), ()),
        ("outage r-b ends", (), A_B),
    ]


def test_a_hop_needs_both_directions() -> None:
    one_way = {"at": "5s", "outage": {"from": "r", "to": "b", "for": "5s"}}
    both = timeline(one_way, outage(4, 9, "a", "s"))
    assert [(entry.at_s, bool(entry.reroutes), bool(entry.rejoins)) for entry in both] == [
        (4.0, True, False),
        (5.0, False, False),
        (10.0, False, True),
        (13.0, False, False),
    ]


def test_a_pulled_cable_cuts_as_well() -> None:
    flap = {"at": "5s", "flap": {"between": ["r", "b"], "down": "2s", "up": "2s", "until": "8s"}}
    assert [(entry.at_s, bool(entry.reroutes)) for entry in timeline(flap)] == [(5.0, True), (7.0, False)]


def test_radios_that_come_and_go_by_a_trace(tmp_path: Path) -> None:
    rows = ["at_s,from,to,loss_percent,delay_ms,rate_mbit"]
    for at, loss in ((0, 0), (3, 100), (6, 5)):
        rows += [f"{at},a,r,{loss},,", f"{at},r,a,{loss},,", f"{at},r,b,0,,", f"{at},b,r,0,,"]
    (tmp_path / "t.csv").write_text("\n".join(rows))
    node = {"processes": ["udp_mesh"]}
    scenario = parse_scenario(
        {
            "duration": "9s",
            "mesh": "batman-adv",
            "radio": {"propagation": {"model": "table", "file": "t.csv"}},
            "nodes": dict.fromkeys("arb", node),
            "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "1Hz"}],
        },
        directory=tmp_path,
    )
    entries = compile_timeline(scenario, compile_plan(scenario))
    assert [(entry.at_s, entry.reroutes, entry.rejoins) for entry in entries] == [(3.0, (), ()), (6.0, (), A_B)]


def test_a_cut_of_what_is_out_of_range_reroutes_nothing(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("at_s,a,b,loss_percent\n0,a,r,0\n0,r,b,0\n0,a,b,0\n3,a,b,100\n")
    scenario = parse_scenario(
        {
            "duration": "60s",
            "mesh": "batman-adv",
            "radio": {"propagation": {"model": "table", "file": "t.csv"}},
            "nodes": {name: {"processes": ["udp_mesh"]} for name in "arb"},
            "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "1Hz"}],
            "events": [outage(1, 1, "a", "b"), outage(5, 1, "a", "b")],
        },
        directory=tmp_path,
    )
    entries = compile_timeline(scenario, compile_plan(scenario))
    assert [(entry.at_s, entry.reroutes) for entry in entries if entry.kind is Kind.OUTAGE] == [(1.0, A_B), (5.0, ())]


def moving(*events: dict[str, object]) -> tuple[list[tuple[Entry, ...]], MeshRoutes, dict[str, int]]:
    """Four radios that go by positions: moments of the timeline, who marks them, and the ports."""
    scenario = parse_scenario(
        {
            "duration": "60s",
            "mesh": "flood",
            "radio": {"phy": "subt", "propagation": {"model": "free_space"}},
            "nodes": {name: {"processes": ["udp_mesh"]} for name in "arsb"} | {"c": {"carried_by": "a"}},
            "traffic": [{"from": "b", "to": "a", "topic": "t", "size": "100B", "rate": "1Hz"}],
            "events": list(events),
        }
    )
    plan = compile_plan(scenario)
    moments = [tuple(moment) for _, moment in groupby(compile_timeline(scenario, plan), key=lambda entry: entry.at_s)]
    return moments, MeshRoutes(scenario, plan), {port.node: port.index for port in plan.ports}


def in_contact(ports: dict[str, int], *pairs: str) -> frozenset[tuple[int, int]]:
    return frozenset(hop for a, b in pairs for hop in ((ports[a], ports[b]), (ports[b], ports[a])))


def test_of_radios_that_move_the_contacts_tell_what_a_cut_means() -> None:
    moments, routes, ports = moving(outage(5, 10, "r", "b"), outage(20, 10, "r", "b"), outage(40, 5, "s", "b"))
    assert all(not entry.reroutes and not entry.rejoins for moment in moments for entry in moment)
    line, diamond = in_contact(ports, "ar", "rb"), in_contact(ports, "ar", "rb", "as", "sb")
    apart = in_contact(ports, "ar", "as")
    contacts = [diamond, diamond, line, line, line, apart]
    found = [routes.mark(moment, heard)[0] for moment, heard in zip(moments, contacts, strict=True)]
    assert marks(tuple(found)) == [
        (5.0, "outage r-b begins", A_B, ()),  # over s
        (15.0, "outage r-b ends", (), ()),
        (20.0, "outage r-b begins", (), ()),  # there was no other way
        (30.0, "outage r-b ends", (), A_B),
        (40.0, "outage s-b begins", (), ()),  # they have not been in contact
        (45.0, "outage s-b ends", (), ()),
    ]


def test_who_is_carried_is_no_way() -> None:
    moments, routes, ports = moving(outage(5, 10, "a", "b"), {"at": "20s", "deploy": "c"}, outage(30, 5, "a", "b"))
    over_c = in_contact(ports, "ab", "ac", "cb")
    first, _end, _drop, later, _last = [routes.mark(moment, over_c)[0] for moment in moments]
    assert (first.reroutes, later.reroutes) == ((), A_B)


def test_nodes_without_a_mesh_are_told_as_before() -> None:
    entries = timeline(outage(5, 10, "r", "b"), mesh="none", traffic=[])
    assert [(entry.restores, entry.reroutes, entry.rejoins) for entry in entries] == [
        (None, (), ()),
        (("r", "b"), (), ()),
    ]
