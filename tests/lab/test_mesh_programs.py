"""What the programs of a node in a mesh are told, and whom its traffic waits for."""

from __future__ import annotations

from pathlib import Path

from netlab.engines.plan import compile_plan
from netlab.lab.programs import daemon_config, node_processes, reach, stream_routes, traffic_sources
from netlab.scenario import Scenario, parse_scenario


def line(mesh: str, **keys: object) -> Scenario:
    return parse_scenario(
        {
            "duration": "5s",
            "mesh": mesh,
            "nodes": {
                "a": {"processes": ["udp_mesh", {"argv": ["my_node"], "env": {"COLOUR": "red"}}]},
                "r": {},
                "b": {"processes": ["udp_mesh"]},
            },
            "links": [{"between": ["a", "r"]}, {"between": ["r", "b"]}],
            **keys,
        }
    )


def test_the_daemon_uses_the_mesh_interface_alone() -> None:
    assert daemon_config(line("batman-adv"), "a")["interfaces"] == ["bat0"]
    assert "interfaces" not in daemon_config(line("none"), "a")


def test_other_programs_find_it_in_their_environment(tmp_path: Path) -> None:
    _, own = node_processes(line("batman-adv"), "a", tmp_path)
    assert own.env == {"NETLAB_MESH_INTERFACE": "bat0", "COLOUR": "red"}
    _, plain = node_processes(line("none"), "a", tmp_path)
    assert plain.env == {"COLOUR": "red"}


def test_over_babel_daemons_are_told_whom_to_ask(tmp_path: Path) -> None:
    config = daemon_config(line("babel"), "a")
    assert (config["neighbours"], "interfaces" in config) == (["10.240.0.3"], False)
    own = daemon_config(line("babel", udp_mesh={"neighbours": []}), "a")
    assert own["neighbours"] == [], "what the scenario says goes first"
    _, process = node_processes(line("babel"), "a", tmp_path)
    assert process.env == {"COLOUR": "red"}


def test_a_source_waits_for_destinations_over_hops() -> None:
    scenario = line("batman-adv", traffic=[{"from": "a", "to": "b", "topic": "t", "size": "1kB", "rate": "1Hz"}])
    (source,) = traffic_sources(scenario, compile_plan(scenario))
    assert source.argv[source.argv.index("--await-peers") + 1] == "b"


def test_reach_ends_where_a_hop_is_out_of_range_or_no_mesh_is() -> None:
    radio = {"propagation": {"model": "table", "pairs": [{"between": ["b", "c"]}, {"from": "c", "to": "d"}]}}
    nodes = {name: {"mesh": "batman-adv"} for name in "bcd"} | {"e": {}}
    scenario = parse_scenario({"duration": "5s", "nodes": nodes, "radio": radio})
    plan = compile_plan(scenario)
    assert {name: reach(scenario, plan, name) for name in "bcde"} == {"b": {"c"}, "c": {"b"}, "d": set(), "e": set()}


def test_t0_waits_until_relays_too_have_routes_to_both_ends_of_a_stream() -> None:
    entry = {"from": "a", "to": "b", "topic": "t", "size": "1kB", "rate": "1Hz"}
    meshed = line("batman-adv", traffic=[entry])
    plain = parse_scenario(
        {
            "duration": "5s",
            "nodes": {name: {"processes": ["udp_mesh"]} for name in "ab"},
            "links": [{"between": ["a", "b"]}],
            "traffic": [entry],
        }
    )
    assert stream_routes(meshed, compile_plan(meshed)) == {("a", "b"), ("b", "a"), ("r", "a"), ("r", "b")}
    assert stream_routes(plain, compile_plan(plain)) == set()
