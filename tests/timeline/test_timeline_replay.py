"""What was done by hand as events of a file: each act, what lasts, what a hold and a step make of the others."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from netlab.scenario import parse_scenario
from netlab.timeline.replay import Row, replay

BASE = """
duration: 60s
radio: {propagation: {model: none}}
nodes:
  a: {waypoints: [[0, 0], [9, 0]], speed: 1m/s, processes: [udp_mesh]}
  b: {processes: [udp_mesh]}
  c: {carried_by: a}
"""


def act(at_s: float | None, do: str, **values: Any) -> Row:
    return Row({"kind": do, "label": do, "at_s": at_s, "act": {"do": do, **values}})


def happened(at_s: float, event: int) -> Row:
    return Row({"kind": "x", "label": "x", "at_s": at_s, "event": event})


def made(*rows: Row, events: tuple[dict[str, Any], ...] = (), end_s: float = 50.0) -> list[dict[str, Any]]:
    """The events, after a file with them has been read without complaint."""
    found = replay(events, rows, duration_s=60.0, end_s=end_s)
    parse_scenario(yaml.safe_load(BASE) | {"events": found.events, "duration": f"{found.duration_s}s"})
    return found.events


AB: dict[str, Any] = {"between": ["a", "b"]}


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (
            [act(5, "outage", **AB, one_way=True, active=True), act(8.5, "outage", **AB, one_way=True, active=False)],
            [{"at": "5s", "outage": {"from": "a", "to": "b", "for": "3.5s"}}],
        ),
        ([act(5, "outage", **AB, active=True)], [{"at": "5s", "outage": {**AB, "for": "55s"}}]),
        (
            [act(5, "carrier", **AB, up=False, over="radio"), act(6, "carrier", **AB, up=True)],
            [{"at": "5s", "flap": {**AB, "over": "radio", "down": "1s", "up": "1s", "until": "6s"}}],
        ),
        (
            [act(2, "flap", **AB, down_s=1.0, up_s=2.0, for_s=20.0)],
            [{"at": "2s", "flap": {**AB, "down": "1s", "up": "2s", "until": "22s"}}],
        ),
        (
            [act(2, "flap", **AB, down_s=1.0, up_s=2.0, for_s=20.0), act(9, "flap_end", **AB)],
            [{"at": "2s", "flap": {**AB, "down": "1s", "up": "2s", "until": "9s"}}],
        ),
        (
            [act(None, "link", **AB, words={"loss": "20%"})],
            [{"at": "0us", "link": {**AB, "loss": "20%"}}],
        ),
        (
            [act(3, "move", node="a", to=[1.0, 2.0], speed_mps=1.5)],
            [{"at": "3s", "move": {"node": "a", "to": [1.0, 2.0], "speed": "1.5m/s"}}],
        ),
        (
            [act(3, "kill", node="b", process="udp_mesh"), act(4.25, "start", node="b", process="udp_mesh")],
            [{"at": "3s", "kill": {"node": "b", "process": "udp_mesh"}, "restart": "1.25s"}],
        ),
        ([act(3, "kill", node="b", process="udp_mesh")], [{"at": "3s", "kill": {"node": "b", "process": "udp_mesh"}}]),
        ([act(3, "mark", text="here")], [{"at": "3s", "mark": "here"}]),
        ([act(60.5, "mark", text="in the drain")], []),
    ],
)
def test_an_act_becomes_an_event(rows: list[Row], expected: list[dict[str, Any]]) -> None:
    assert made(*rows) == expected


def test_two_directions_that_are_restored_together_both_end() -> None:
    events = made(
        act(1, "outage", between=["a", "b"], one_way=True, active=True),
        act(2, "outage", between=["b", "a"], one_way=True, active=True),
        act(4, "outage", between=["b", "a"], active=False),
    )
    assert [(event["at"], event["outage"]["for"]) for event in events] == [("1s", "3s"), ("2s", "2s")]


def test_an_early_deployment_replaces_the_planned_one() -> None:
    planned = {"at": "40s", "deploy": "c"}
    assert made(act(7, "deploy", node="c"), events=(planned,)) == [{"at": "7s", "deploy": "c"}]


def test_events_on_time_stay_as_the_file_has_them() -> None:
    outage = {"at": "10000ms", "outage": {**AB, "for": "5000ms"}}
    assert made(happened(10.0, 0), happened(15.0, 0), events=(outage,)) == [outage]


def test_a_hold_moves_what_comes_later_and_stops_motion() -> None:
    outage, late = {"at": "10s", "outage": {**AB, "for": "5s"}}, {"at": "58s", "mark": "late"}
    found = replay([outage, late], [act(12, "hold"), act(20, "resume")], duration_s=60.0, end_s=30.0)
    assert found.duration_s == 68.0
    assert found.events == [
        {"at": "10s", "outage": {**AB, "for": "13s"}},
        {"at": "66s", "mark": "late"},
        {"at": "12s", "hold": "8s"},
    ]


def test_a_step_gives_an_event_its_real_time() -> None:
    rows = (act(2, "hold"), happened(3.0, 0), happened(4.5, 0), act(5, "resume"))
    events = made(*rows, events=({"at": "30s", "outage": {**AB, "for": "5s"}},))
    assert events == [{"at": "3s", "outage": {**AB, "for": "1.5s"}}, {"at": "2s", "hold": "3s"}]


def test_what_no_event_says_is_named() -> None:
    found = replay([], [act(3, "start", node="b", process="udp_mesh")], duration_s=60.0, end_s=9.0)
    assert found.left_out == ("start of udp_mesh on b: it had ended by itself",)
