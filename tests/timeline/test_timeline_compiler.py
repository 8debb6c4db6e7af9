"""Events to actions: composition of overlapping cuts, restorations, order, live changes, radio traces."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from netlab.engines.plan import compile_plan
from netlab.medium.impairments import Impairment, RandomLoss
from netlab.scenario import parse_scenario
from netlab.timeline import (
    DeployNode,
    Entry,
    HoldMotion,
    KillProcess,
    Kind,
    MoveNode,
    Nothing,
    SetCarrier,
    SetOutage,
    SetPairs,
    StartProcess,
    compile_timeline,
)

WIRE = [{"between": ["a", "b"]}, {"between": ["b", "c"]}]  # ports: a 0, b 1 and 2, c 3
A_B = frozenset({(0, 1), (1, 0)})


def timeline(*events: dict[str, object], **keys: object) -> tuple[Entry, ...]:
    scenario = parse_scenario(
        {
            "duration": "60s",
            "nodes": {"a": {"processes": ["udp_mesh"]}, "b": {}, "c": {}},
            "links": WIRE,
            "events": list(events),
            **keys,
        }
    )
    return compile_timeline(scenario, compile_plan(scenario))


def outage(at: str, length: str, **keys: object) -> dict[str, object]:
    return {"at": at, "outage": {"between": ["a", "b"], "for": length, **keys}}


def test_an_outage_begins_ends_and_restores() -> None:
    assert timeline(outage("5s", "15s")) == (
        Entry(5.0, Kind.OUTAGE, "outage a-b begins", SetOutage(A_B, active=True)),
        Entry(20.0, Kind.OUTAGE_END, "outage a-b ends", SetOutage(A_B, active=False), ("a", "b")),
    )


def test_overlapping_outages_are_one_cut_that_ends_with_the_last() -> None:
    entries = timeline(outage("5s", "10s"), outage("8s", "20s"), outage("9s", "1s"))
    assert [(entry.at_s, entry.kind, entry.restores) for entry in entries] == [
        (5.0, Kind.OUTAGE, None),
        (28.0, Kind.OUTAGE_END, ("a", "b")),
    ]


def test_a_cut_that_follows_another_without_a_gap_lets_nothing_through() -> None:
    entries = timeline(outage("10s", "5s"), outage("5s", "5s"))
    assert [entry.at_s for entry in entries] == [5.0, 15.0]


def test_a_one_way_outage_cuts_one_direction_and_restores_only_when_both_are_free() -> None:
    one_way = {"at": "5s", "outage": {"from": "a", "to": "b", "for": "10s"}}
    other_way = {"at": "6s", "outage": {"from": "b", "to": "a", "for": "1s"}}
    entries = timeline(one_way, other_way)
    assert [(entry.label, entry.action, entry.restores) for entry in entries] == [
        ("outage a->b begins", SetOutage(frozenset({(0, 1)}), active=True), None),
        ("outage b->a begins", SetOutage(frozenset({(1, 0)}), active=True), None),
        ("outage b->a ends", SetOutage(frozenset({(1, 0)}), active=False), None),
        ("outage a->b ends", SetOutage(frozenset({(0, 1)}), active=False), ("a", "b")),
    ]


def test_a_flap_pulls_the_cable_down_first_and_ends_up() -> None:
    entries = timeline({"at": "10s", "flap": {"between": ["a", "b"], "up": "1s", "down": "2s", "until": "17s"}})
    ports = frozenset({0, 1})
    assert [(entry.at_s, entry.action, entry.restores) for entry in entries] == [
        (10.0, SetCarrier(ports, up=False), None),
        (12.0, SetCarrier(ports, up=True), ("a", "b")),
        (13.0, SetCarrier(ports, up=False), None),
        (15.0, SetCarrier(ports, up=True), ("a", "b")),
        (16.0, SetCarrier(ports, up=False), None),
        (17.0, SetCarrier(ports, up=True), ("a", "b")),
    ]


def test_a_flap_without_carrier_is_silent() -> None:
    flap = {"between": ["a", "b"], "up": "1s", "down": "2s", "until": "12s", "carrier": "off"}
    down, up = timeline({"at": "10s", "flap": flap})
    assert (down.action, up.action) == (SetOutage(A_B, active=True), SetOutage(A_B, active=False))
    assert down.kind is Kind.FLAP_DOWN


def test_an_outage_over_a_flap_restores_only_when_neither_holds() -> None:
    flap = {"at": "10s", "flap": {"between": ["a", "b"], "up": "2s", "down": "2s", "until": "18s"}}
    entries = timeline(flap, outage("11s", "4s"))
    assert [(entry.at_s, entry.kind, entry.restores) for entry in entries] == [
        (10.0, Kind.FLAP_DOWN, None),
        (11.0, Kind.OUTAGE, None),
        (12.0, Kind.FLAP_UP, None),  # the outage still holds
        (14.0, Kind.FLAP_DOWN, None),
        (15.0, Kind.OUTAGE_END, None),  # the cable is out
        (16.0, Kind.FLAP_UP, ("a", "b")),
    ]


def test_a_pulled_cable_is_counted_apart_for_each_wire() -> None:
    def flap(a: str, b: str) -> dict[str, object]:
        return {"at": "10s", "flap": {"between": [a, b], "up": "9s", "down": "2s", "until": "12s"}}

    entries = timeline(flap("a", "b"), flap("b", "c"))
    assert [entry.action for entry in entries] == [
        SetCarrier(frozenset({0, 1}), up=False),
        SetCarrier(frozenset({2, 3}), up=False),
        SetCarrier(frozenset({0, 1}), up=True),
        SetCarrier(frozenset({2, 3}), up=True),
    ]


def test_a_flap_of_wire_and_radio_pulls_the_one_and_silences_the_other() -> None:
    flap = {"at": "1s", "flap": {"between": ["a", "b"], "up": "9s", "down": "2s", "until": "3s"}}
    entries = timeline(flap, radio={"propagation": {"model": "none"}})
    assert [(entry.action, entry.restores) for entry in entries] == [
        (SetCarrier(frozenset({0, 2}), up=False), None),
        (SetOutage(frozenset({(1, 4), (4, 1)}), active=True), None),
        (SetCarrier(frozenset({0, 2}), up=True), None),
        (SetOutage(frozenset({(1, 4), (4, 1)}), active=False), ("a", "b")),
    ]


def test_over_picks_the_medium() -> None:
    entries = timeline(outage("1s", "1s", over="radio"), radio={"propagation": {"model": "none"}})
    assert entries[0].action == SetOutage(frozenset({(1, 4), (4, 1)}), active=True)


def test_nothing_begins_after_the_end_but_endings_are_kept() -> None:
    flap = {"at": "50s", "flap": {"between": ["b", "c"], "up": "4s", "down": "4s", "until": "200s"}}
    entries = timeline(outage("55s", "30s"), flap)
    late = [entry for entry in entries if entry.at_s >= 60.0]
    assert [(entry.at_s, entry.kind) for entry in late] == [(62.0, Kind.FLAP_UP), (85.0, Kind.OUTAGE_END)]


def test_a_link_change_keeps_the_words_that_it_does_not_name_and_adds_up() -> None:
    links = [{"between": ["a", "b"], "delay": "20ms", "rate": "10mbit"}, {"from": "b", "to": "a", "loss": "1%"}]
    first, second = timeline(
        {"at": "2s", "link": {"from": "a", "to": "b", "delay": "5ms"}},
        {"at": "1s", "link": {"between": ["a", "b"], "loss": "20%"}},
        links=links,
    )
    lossy = Impairment(delay_s=0.02, rate_bps=10e6, loss=RandomLoss(0.2))
    assert (first.label, first.action) == ("link a-b: loss 20%", SetPairs({(0, 1): lossy, (1, 0): lossy}))
    quick = Impairment(delay_s=0.005, rate_bps=10e6, loss=RandomLoss(0.2))
    assert (second.label, second.action) == ("link a->b: delay 5ms", SetPairs({(0, 1): quick}))


def test_a_link_change_can_take_loss_away_again() -> None:
    _, after = timeline(
        {"at": "1s", "link": {"between": ["a", "b"], "loss": "20%"}},
        {"at": "2s", "link": {"between": ["a", "b"], "loss": "0%"}},
    )
    assert after.action == SetPairs(dict.fromkeys(A_B, Impairment()))


def test_kill_and_restart() -> None:
    entries = timeline({"at": "59s", "kill": {"node": "a", "process": "udp_mesh"}, "restart": "2s"})
    assert [(entry.at_s, entry.kind, entry.action) for entry in entries] == [
        (59.0, Kind.KILL, KillProcess("a", "udp_mesh")),
        (61.0, Kind.START, StartProcess("a", "udp_mesh")),
    ]


def test_a_radio_trace_sets_the_start_and_changes_pairs_over_time(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        "at_s,from,to,loss_percent,delay_ms,rate_mbit\n"
        "0,a,b,10,2,6\n"
        "5,a,b,20,,\n"
        "5,b,a,0,,\n"
        "8,a,b,100,,\n"
        "9,a,b,,3,\n"
        "10,a,b,5,,\n"
        "99,a,b,1,,\n"
    )
    radio = {"jitter": "1ms", "propagation": {"model": "table", "file": "t.csv"}}
    source = {"duration": "60s", "nodes": {"a": {}, "b": {}}, "radio": radio}
    scenario = parse_scenario(source, directory=tmp_path)
    plan = compile_plan(scenario)
    assert plan.segments[0].pairs == {
        (0, 1): Impairment(jitter_s=0.001, loss=RandomLoss(0.1), delay_s=0.002, rate_bps=6e6)
    }
    entries = compile_timeline(scenario, plan)
    assert [(entry.at_s, entry.action) for entry in entries] == [
        (
            5.0,
            SetPairs(
                {
                    (0, 1): Impairment(jitter_s=0.001, loss=RandomLoss(0.2), delay_s=0.002, rate_bps=6e6),
                    (1, 0): Impairment(jitter_s=0.001),
                }
            ),
        ),
        (8.0, SetPairs({(0, 1): None})),
        (9.0, SetPairs({(0, 1): None})),
        (10.0, SetPairs({(0, 1): Impairment(jitter_s=0.001, loss=RandomLoss(0.05), delay_s=0.003, rate_bps=6e6)})),
    ]
    assert [entry.label for entry in entries[:2]] == ["radio trace: a and b hear each other", "radio trace: 1 pair"]


def test_who_comes_back_into_range_by_a_trace_is_restored(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        "at_s,a,b,loss_percent\n0,a,b,0\n0,a,c,0\n5,a,b,100\n5,a,c,50\n9,a,b,3\n9,a,c,5\n12,a,b,100\n20,a,b,0\n"
    )
    source = {
        "duration": "60s",
        "nodes": {"a": {}, "b": {}, "c": {}},
        "radio": {"propagation": {"model": "table", "file": "t.csv"}},
        "events": [
            {"at": "13s", "outage": {"between": ["a", "b"], "for": "2s"}},  # ends while they are out of range
            {"at": "18s", "outage": {"between": ["a", "b"], "for": "4s"}},
        ],
    }
    scenario = parse_scenario(source, directory=tmp_path)
    entries = compile_timeline(scenario, compile_plan(scenario))
    assert [(entry.at_s, entry.label, entry.restores) for entry in entries if entry.at_s in (5, 9, 15, 20, 22)] == [
        (5.0, "radio trace: 4 pairs", None),
        (9.0, "radio trace: a and b hear each other", ("a", "b")),
        (9.0, "radio trace: 2 pairs", None),
        (15.0, "outage a-b ends", None),
        (20.0, "radio trace: 2 pairs", None),
        (22.0, "outage a-b ends", ("a", "b")),
    ]


_CUT = st.tuples(
    st.sampled_from(["outage", "flap", "silent_flap"]),
    st.sampled_from([("a", "b"), ("b", "c"), ("b", "a")]),
    st.booleans(),
    st.integers(0, 50),
    st.integers(1, 20),
    st.integers(1, 5),
)


def _event(kind: str, ends: tuple[str, str], one_way: bool, at: int, length: int, period: int) -> dict[str, object]:
    where: dict[str, object] = {"from": ends[0], "to": ends[1]} if one_way else {"between": list(ends)}
    if kind == "outage":
        return {"at": f"{at}s", "outage": {**where, "for": f"{length}s"}}
    carrier = {} if kind == "flap" else {"carrier": False}
    flap = {**where, **carrier, "up": f"{period}s", "down": f"{period}s", "until": f"{at + length}s"}
    return {"at": f"{at}s", "flap": flap}


@given(st.lists(_CUT, max_size=8))
def test_any_mixture_of_cuts_switches_each_thing_alternately_and_leaves_all_up(
    cuts: list[tuple[str, tuple[str, str], bool, int, int, int]],
) -> None:
    entries = timeline(*(_event(*cut) for cut in cuts))
    assert entries == timeline(*(_event(*cut) for cut in cuts))
    down: set[object] = set()
    for entry in entries:
        action = entry.action
        assert isinstance(action, (SetOutage, SetCarrier))
        things = set(action.pairs) if isinstance(action, SetOutage) else set(action.ports)
        falls = action.active if isinstance(action, SetOutage) else not action.up
        assert things, "an entry changes something"
        assert things.isdisjoint(down) if falls else things <= down
        down = down | things if falls else down - things
        if entry.restores is not None:
            assert not falls
            assert not _apart(set(entry.restores), down)
    assert not down
    assert [entry.at_s for entry in entries] == sorted(entry.at_s for entry in entries)


def _apart(ends: set[str], down: set[object]) -> bool:
    ports = {0, 1} if ends == {"a", "b"} else {2, 3}
    return any(thing in ports or (isinstance(thing, tuple) and set(thing) <= ports) for thing in down)


def test_a_dropped_node_comes_on_the_air_and_a_moved_one_is_told() -> None:
    nodes = {"a": {}, "b": {}, "c": {"carried_by": "a"}, "d": {"carried_by": "a"}}
    entries = timeline(
        {"at": "5s", "deploy": "c"},
        {"at": "6s", "move": {"node": "b", "to": [1, 2.5], "speed": "2m/s"}},
        nodes=nodes,
        links=[],
        radio={"propagation": {"model": "none"}},
    )
    dropped = DeployNode("c", frozenset({(2, 0), (2, 1), (2, 3), (0, 2), (1, 2), (3, 2)}))
    assert [(entry.at_s, entry.kind, entry.action) for entry in entries] == [
        (5, Kind.DEPLOY, dropped),
        (6, Kind.MOVE, MoveNode("b")),
    ]
    assert entries[1].label == "move b to [1, 2.5] at 2m/s"


def test_a_dropped_node_joins_the_ends_of_a_stream_in_a_mesh() -> None:
    words = {"propagation": {"model": "table", "pairs": [{"between": ["a", "c"]}, {"between": ["c", "b"]}]}}
    entries = timeline(
        {"at": "5s", "deploy": "c"},
        nodes={"a": {"processes": ["udp_mesh"]}, "b": {"processes": ["udp_mesh"]}, "c": {"carried_by": "a"}},
        links=[],
        radio=words,
        mesh="batman-adv",
        traffic=[{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "1Hz"}],
    )
    [entry] = entries
    assert entry.rejoins == (("a", "b"),)


def test_a_mark_does_nothing_and_a_hold_stops_motion_for_its_time() -> None:
    assert timeline({"at": "3s", "mark": "here"}, {"at": "5s", "hold": "2s"}) == (
        Entry(3.0, Kind.MARK, "here", Nothing()),
        Entry(5.0, Kind.HOLD, "motion stands still", HoldMotion(active=True)),
        Entry(7.0, Kind.RESUME, "motion goes on", HoldMotion(active=False)),
    )


def test_entries_know_the_event_that_they_come_from() -> None:
    entries = timeline({"at": "9s", "mark": "late"}, outage("5s", "1s"))
    assert [(entry.at_s, entry.event) for entry in entries] == [(5.0, 1), (6.0, 1), (9.0, 0)]
