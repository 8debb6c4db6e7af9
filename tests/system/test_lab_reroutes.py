"""Cuts in a mesh of radios that move: only those that a path survives, and that cut something, are reroutes."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.pytest_plugin import MakeLab

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


@pytest.mark.usefixtures("taps")
def test_a_cut_counts_by_who_is_in_range(make_lab: MakeLab) -> None:
    result = make_lab(SCENARIO).run()
    assert not result.problems
    assert result.passed, result.report()
    assert [round(entry["cut_at_s"], 1) for entry in result.summary["reroutes"]] == [4.0]
    assert [round(entry["restored_at_s"], 1) for entry in result.summary["reconnects"]] == [10.0]
