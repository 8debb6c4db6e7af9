"""udp_mesh's bridges in scenario files: who reaches whom over one, and for whom a source waits."""

from __future__ import annotations

import pytest

from netlab.engines.plan import compile_plan
from netlab.errors import ScenarioError
from netlab.lab.programs import daemon_config, reach, traffic_sources
from netlab.scenario import Scenario, parse_scenario


def line(*, bridge: bool, **keys: object) -> Scenario:
    nodes: dict[str, dict[str, object]] = {name: {"processes": ["udp_mesh"]} for name in ("a", "x", "b", "c")}
    if bridge:
        nodes["x"]["udp_mesh"] = {"bridge": True}
    joined = (("a", "x"), ("x", "b"), ("b", "c"))
    links = [{"between": list(pair)} for pair in joined]
    return parse_scenario({"duration": "1s", "nodes": nodes, "links": links, **keys})


STREAM = {"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "10Hz"}


def test_a_stream_may_cross_one_bridge() -> None:
    scenario = line(bridge=True, traffic=[STREAM])
    assert daemon_config(scenario, "x")["bridge"] is True
    assert "bridge" not in daemon_config(scenario, "a")
    plan = compile_plan(scenario)
    assert {name: reach(scenario, plan, name) for name in ("a", "x", "b", "c")} == {
        "a": {"x", "b"},
        "x": {"a", "b"},
        "b": {"x", "a", "c"},
        "c": {"b"},
    }
    (source,) = traffic_sources(scenario, plan)
    assert source.argv[source.argv.index("--await-peers") + 1] == "b"


def test_without_a_bridge_or_over_two_hops_it_may_not() -> None:
    for scenario in (
        {"bridge": False, "traffic": [STREAM]},
        {"bridge": True, "traffic": [STREAM | {"to": "c"}]},
    ):
        with pytest.raises(ScenarioError, match="share no link or radio"):
            line(**scenario)  # type: ignore[arg-type]


def test_to_all_means_who_is_behind_a_bridge_too() -> None:
    streams = line(bridge=True, traffic=[STREAM | {"to": "all"}]).streams()
    assert [stream.destination for stream in streams] == ["x", "b"]


def test_one_radio_is_one_carrier() -> None:
    """Nodes of one channel that are out of range of each other are not bridged by a third."""
    radio = {"propagation": {"model": "table", "pairs": [{"between": ["a", "x"]}, {"between": ["x", "b"]}]}}
    nodes = {name: {"processes": ["udp_mesh"], "udp_mesh": {"bridge": True}} for name in ("a", "x", "b")}
    scenario = parse_scenario({"duration": "1s", "nodes": nodes, "radio": radio})
    assert reach(scenario, compile_plan(scenario), "a") == {"x"}


def test_two_frequencies_are_two_carriers() -> None:
    fast = {"frequency": "5.18GHz", "phy": "802.11n-20MHz-2x2"}
    nodes: dict[str, dict[str, object]] = {"base": {}, "parent": {"radio": [{}, fast]}, "uav": {"radio": fast}}
    for node in nodes.values():
        node["processes"] = ["udp_mesh"]
    nodes["parent"]["udp_mesh"] = {"bridge": True}
    radio = {"phy": "802.11g-20MHz", "rate": "6mbit", "noise": "-90dBm", "propagation": {"model": "free_space"}}
    stream = STREAM | {"from": "uav", "to": "base"}
    scenario = parse_scenario({"duration": "5s", "radio": radio, "nodes": nodes, "traffic": [stream]})
    assert scenario.reaches("uav", "base")
