"""A topic's settings belong to its sender's daemon."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.errors import ScenarioError
from netlab.scenario import parse_scenario

MESH = {"processes": ["udp_mesh"]}


def _scenario(*traffic: dict[str, Any]) -> Any:
    return parse_scenario(
        {
            "duration": "5s",
            "nodes": {"a": MESH, "b": MESH, "c": MESH},
            "links": [{"between": ["a", "b"]}, {"between": ["a", "c"]}],
            "traffic": [{"topic": "map", "size": "1kB", "rate": "1Hz", **entry} for entry in traffic],
        }
    )


def test_one_sender_cannot_publish_a_topic_with_two_priorities() -> None:
    with pytest.raises(
        ScenarioError, match=r"traffic\[1\]\.topic: 'a' publishes 'map' with other settings in traffic\[0\]"
    ):
        _scenario({"from": "a", "to": "b", "priority": 1}, {"from": "a", "to": "c", "priority": 2})


def test_two_senders_can_and_sizes_and_rates_may_differ() -> None:
    _scenario({"from": "a", "to": "b", "priority": 1}, {"from": "b", "to": "a", "priority": 2})
    _scenario({"from": "a", "to": "b"}, {"from": "a", "to": "c", "size": "2kB", "rate": "5Hz"})
