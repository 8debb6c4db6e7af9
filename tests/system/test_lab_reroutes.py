"""Cuts in a mesh: which of them count, and how soon there is another way. In virtual time: the claims are times."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.pytest_plugin import MakeLab
from tests.system.mesh_lines import line

pytestmark = [pytest.mark.usefixtures("taps"), pytest.mark.lab_clock("virtual")]

NODE = {"processes": ["udp_mesh"]}
SCENARIO: dict[str, Any] = {
    "duration": "12s",
    "mesh": "flood",
    "radio": {
        "phy": "802.11g-20MHz",
        "rate": "6mbit",
        "propagation": {"model": "log_distance", "exponent": 4},
    },
    "nodes": {
        "a": {"position": [0, 0], **NODE},
        "r": {"position": [40, 0]},
        "s": {"position": [40, 20]},
        "b": {"position": [80, 0], **NODE},
        "far": {"position": [4000, 0]},
    },
    "traffic": [
        {"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "10Hz"},
        {"from": "b", "to": "a", "topic": "t", "size": "100B", "rate": "10Hz"},
    ],
    "events": [
        {"at": "2s", "outage": {"between": ["a", "far"], "for": "1s"}},  # who never hear each other
        {"at": "4s", "outage": {"between": ["a", "r"], "for": "2s"}},  # over s, or directly
        {"at": "8s", "outage": {"between": ["a", "r"], "for": "2s"}},
        {"at": "8s", "outage": {"between": ["a", "s"], "for": "2s"}},
        {"at": "8s", "outage": {"between": ["a", "b"], "for": "2s"}},  # nothing is left
    ],
    "expect": [
        {"reroute": {"between": ["a", "b"]}, "max": "300ms"},
        {"reconnect": {"between": ["a", "b"]}, "max": "300ms"},
    ],
}


def test_a_cut_counts_by_who_is_in_range(make_lab: MakeLab) -> None:
    result = make_lab(SCENARIO).run()
    assert not result.problems
    assert result.passed, result.report()
    assert [round(entry["cut_at_s"], 1) for entry in result.summary["reroutes"]] == [4.0]
    assert [round(entry["restored_at_s"], 1) for entry in result.summary["reconnects"]] == [10.0]


@pytest.mark.parametrize(
    ("mesh", "max_s"),
    [
        ("flood", 0.15),  # one message interval and one way: it uses both
        ("wnet", 0.3),
    ],
)
def test_a_cut_costs_little_while_another_way_is_left(make_lab: MakeLab, mesh: str, max_s: float) -> None:
    ways = [("a", "r"), ("r", "b"), ("a", "q"), ("q", "b")]
    cuts = [("0.5s", "r"), ("1.5s", "q")]
    of_line = line(mesh)
    diamond = {
        **of_line,
        "duration": "2.5s",
        "nodes": {**of_line["nodes"], "q": {}},
        "links": [{"between": list(way), "delay": "2ms"} for way in ways],
        "events": [{"at": at, "outage": {"between": [relay, "b"], "for": "800ms"}} for at, relay in cuts],
    }
    result = make_lab(diamond, packets=False).run()
    delays = [row["delay_s"] for row in result.summary["reroutes"]]
    assert len(delays) == 2
    assert all(delay is not None and delay < max_s for delay in delays), result.report()
    assert result.stream("t")["delivered"] == result.stream("t")["sent"]
