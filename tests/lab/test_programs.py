"""What runs in the nodes of a scenario: daemon configuration, streams, sources and sinks."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from netlab.engines.plan import compile_plan
from netlab.lab import programs
from netlab.lab.resolution import SPREAD_S
from netlab.scenario import parse_scenario

MESH = {"processes": ["udp_mesh"]}


def _scenario(**more: Any) -> Any:
    return parse_scenario(
        {
            "name": "team",
            "seed": 3,
            "duration": "10s",
            "nodes": {"base": MESH, "r1": {**MESH, "udp_mesh": {"window": 3}}, "r2": MESH},
            "links": [{"between": ["base", "r1"]}, {"between": ["r1", "r2"]}],
            **more,
        }
    )


TRAFFIC = [
    {"from": "r1", "to": "base", "topic": "telemetry", "priority": 1, "size": "200B", "rate": "10Hz"},
    {"from": "r1", "to": "all", "topic": "estop", "priority": 0, "size": "50B", "rate": "1Hz"},
    {
        "from": "r1",
        "to": ["base", "r2"],
        "topic": "map",
        "priority": 7,
        "size": "20kB",
        "rate": "0.5Hz",
        "lifetime": "5s",
    },
]


def test_the_daemon_gets_the_settings_of_file_and_node_and_every_topic(tmp_path: Path) -> None:
    scenario = _scenario(traffic=TRAFFIC, udp_mesh={"window": 8, "probe": False, "topics": {"map": {"keep": "latest"}}})
    (spec,) = programs.node_processes(scenario, "r1", tmp_path)
    config = tomllib.loads((tmp_path / "r1.udp_mesh.toml").read_text())
    assert str(tmp_path / "r1.udp_mesh.toml") in spec.argv
    assert spec.waits_for_ready
    assert (config["name"], config["window"], config["probe"]) == ("r1", 3, False)
    assert config["topics"]["telemetry"]["priority"] == 1
    assert config["topics"]["map"] == {
        "priority": 7,
        "reliability": "reliable",
        "keep": "latest",
        "offline": "discard",
        "redundancy": 1,
        "lifetime_s": 5.0,
    }


def test_streams_are_numbered_by_entry_and_destination_and_one_publication_goes_to_all() -> None:
    streams = programs.streams(_scenario(traffic=TRAFFIC))
    rows = [(s.stream, s.publication, s.to_all, s.source, s.destination, s.topic) for s in streams]
    assert rows == [
        (0, 0, False, "r1", "base", "telemetry"),
        (1, 1, True, "r1", "base", "estop"),
        (2, 1, True, "r1", "r2", "estop"),
        (3, 3, False, "r1", "base", "map"),
        (4, 4, False, "r1", "r2", "map"),
    ]
    assert streams[3].interval_s == 2.0


def test_sources_wait_for_the_destinations_that_they_can_reach() -> None:
    reply = {"from": "base", "to": "r1", "topic": "command", "size": "50B", "rate": "1Hz"}
    scenario = _scenario(traffic=[*TRAFFIC, reply])
    sources = {spec.node: spec for spec in programs.traffic_sources(scenario, compile_plan(scenario))}
    assert set(sources) == {"r1", "base"}
    awaited = {node: spec.argv[spec.argv.index("--await-peers") + 1] for node, spec in sources.items()}
    assert awaited == {"r1": "base,r2", "base": "r1"}
    assert not any("--resolve-spread-s" in spec.argv for spec in sources.values())


@pytest.mark.parametrize(
    ("words", "spread_s"),
    [
        ({"radio": {"phy": "802.11g-20MHz", "propagation": {"model": "none"}}}, SPREAD_S),
        ({"radio": {"loss": "5%", "propagation": {"model": "none"}}}, 0.0),
    ],
)
def test_where_requests_may_get_lost_link_addresses_are_known_before_the_start(
    words: dict[str, Any], spread_s: float
) -> None:
    scenario = _scenario(traffic=TRAFFIC, **words)
    sources = programs.traffic_sources(scenario, compile_plan(scenario))
    assert {spec.argv[spec.argv.index("--resolve-spread-s") + 1] for spec in sources} == {str(spread_s)}


def test_every_receiver_has_one_sink_with_all_its_streams() -> None:
    sinks = {spec.node: spec for spec in programs.traffic_sinks(_scenario(traffic=TRAFFIC))}
    numbers = {
        node: [row["stream"] for row in json.loads(spec.argv[spec.argv.index("--streams") + 1])]
        for node, spec in sinks.items()
    }
    assert numbers == {"base": [0, 1, 3], "r2": [2, 4]}


def test_other_programs_keep_their_argv(tmp_path: Path) -> None:
    nodes = {"a": {"processes": [{"argv": ["babeld", "eth0"], "env": {"X": "1"}, "restart": "always"}]}, "b": {}}
    scenario = parse_scenario({"name": "x", "duration": "1s", "nodes": nodes, "links": [{"between": ["a", "b"]}]})
    (spec,) = programs.node_processes(scenario, "a", tmp_path)
    assert (spec.argv, dict(spec.env), spec.restart, spec.name) == (("babeld", "eth0"), {"X": "1"}, "always", "babeld")
