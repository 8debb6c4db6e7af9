"""What files mean: wires out of entries, streams, daemon settings, processes, radios, traces."""

from pathlib import Path

import pytest

from netlab.errors import ScenarioError
from netlab.scenario import Scenario, load_scenario, parse_scenario
from netlab.scenario.links import Wire

NODES = {"a": {"processes": ["udp_mesh"]}, "b": {"processes": ["udp_mesh"]}, "c": {"processes": ["udp_mesh"]}}


def scenario(**keys: object) -> Scenario:
    return parse_scenario({"duration": "10s", "nodes": NODES, **keys})


def wires(*links: dict[str, object]) -> tuple[Wire, ...]:
    return scenario(links=list(links)).wires()


def test_between_holds_for_both_directions() -> None:
    [wire] = wires({"between": ["a", "b"], "delay": "20ms"})
    assert (wire.a, wire.b) == ("a", "b")
    assert wire.forward.delay_s == wire.backward.delay_s == 0.02


def test_two_one_way_entries_make_one_wire() -> None:
    [wire] = wires({"from": "b", "to": "a", "delay": "1ms"}, {"from": "a", "to": "b", "delay": "2ms"})
    assert (wire.a, wire.b) == ("b", "a")
    assert (wire.forward.delay_s, wire.backward.delay_s) == (0.001, 0.002)


def test_a_lone_one_way_entry_leaves_the_way_back_perfect() -> None:
    [wire] = wires({"from": "a", "to": "b", "loss": "5%"})
    assert wire.forward.loss is not None
    assert wire.backward.given() == {}


@pytest.mark.parametrize("one_way_first", [False, True])
def test_a_one_way_entry_refines_the_link_between_wherever_it_stands(one_way_first: bool) -> None:
    links = [
        {"between": ["a", "b"], "rate": "10mbit", "loss": "1%"},
        {"from": "b", "to": "a", "loss": {"gemodel": {"p": "1%", "r": "25%"}}},
    ]
    [wire] = wires(*(reversed(links) if one_way_first else links))
    ways = {(wire.a, wire.b): wire.forward, (wire.b, wire.a): wire.backward}
    assert ways["a", "b"].loss is not None
    assert ways["a", "b"].loss.ratio == 0.01
    assert ways["b", "a"].loss is not None
    assert ways["b", "a"].loss.gemodel is not None
    assert ways["b", "a"].rate_bps == ways["a", "b"].rate_bps == 10e6


def test_streams_are_numbered_by_entry_and_destination() -> None:
    def entry(source: str, to: object, topic: str) -> dict[str, object]:
        return {"from": source, "to": to, "topic": topic, "size": "100B", "rate": "1Hz"}

    mesh = scenario(
        links=[{"between": ["a", "b"]}, {"between": ["a", "c"]}],
        traffic=[entry("b", "a", "x"), entry("a", ["c", "b"], "y"), entry("a", "all", "z")],
    )
    assert [(s.index, s.entry, s.source, s.destination, s.topic, s.priority) for s in mesh.streams()] == [
        (0, 0, "b", "a", "x", 5),
        (1, 1, "a", "c", "y", 5),
        (2, 1, "a", "b", "y", 5),
        (3, 2, "a", "b", "z", 5),
        (4, 2, "a", "c", "z", 5),
    ]


def test_all_means_those_who_can_be_reached_and_listen() -> None:
    mesh = parse_scenario(
        {
            "duration": "1s",
            "nodes": {**NODES, "deaf": {}, "far": {"processes": ["udp_mesh"]}},
            "links": [{"between": ["a", "b"]}, {"between": ["a", "deaf"]}, {"between": ["b", "far"]}],
            "traffic": [{"from": "a", "to": "all", "topic": "x", "size": "100B", "rate": "1Hz"}],
        }
    )
    assert [stream.destination for stream in mesh.streams()] == ["b"]


def test_traffic_between_nodes_that_nothing_joins_is_refused() -> None:
    with pytest.raises(ScenarioError, match="'b' and 'c' share no link or radio, and nothing is routed"):
        scenario(
            links=[{"between": ["a", "b"]}, {"between": ["a", "c"]}],
            traffic=[{"from": "b", "to": "c", "topic": "x", "size": "100B", "rate": "1Hz"}],
        )


def test_daemon_settings_are_overlaid_by_the_node() -> None:
    mesh = parse_scenario(
        {
            "duration": "1s",
            "udp_mesh": {"window": 3, "probe": "off", "beacon_interval": "500ms", "payload_bytes": 1200},
            "nodes": {"a": {"udp_mesh": {"window": 0, "topics": {"t": {"priority": 1, "lifetime": "2s"}}}}, "b": {}},
        }
    )
    top = {"window": 3, "probe": False, "beacon_interval_s": 0.5, "payload_bytes": 1200}
    assert mesh.mesh_settings("b") == top
    assert mesh.mesh_settings("a") == {**top, "window": 0, "topics": {"t": {"priority": 1, "lifetime_s": 2.0}}}


def test_processes_take_their_names_and_readiness_from_what_they_are() -> None:
    node = parse_scenario(
        {
            "duration": "1s",
            "nodes": {"a": {"processes": ["udp_mesh", {"argv": ["/bin/sleep", 5], "env": {"N": 1, "DEBUG": True}}]}},
        }
    ).nodes["a"]
    daemon, sleep = node.processes
    assert (daemon.name, daemon.builtin, daemon.ready, daemon.restart) == ("udp_mesh", "udp_mesh", "fd", "never")
    assert (sleep.name, sleep.argv, sleep.ready) == ("sleep", ("/bin/sleep", "5"), "started")
    assert sleep.env == {"N": "1", "DEBUG": "true"}


def test_a_scenario_is_named_after_its_file_unless_it_says_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "my first.yaml"
    path.write_text("duration: 1s\nnodes: {a: }\n")
    assert load_scenario(path).name == "my-first"
    assert load_scenario(path, overrides=["name=other"]).name == "other"


def test_a_loss_trace_comes_from_a_list_or_a_file_beside_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "loss.txt").write_text("0 1 # first two\n11\n")
    path = tmp_path / "s.yaml"
    path.write_text("duration: 1s\nnodes: {a: , b: }\nlinks: [{between: [a, b], loss: {trace: loss.txt}}]\n")
    [wire] = load_scenario(path).wires()
    assert wire.forward.loss is not None
    assert wire.forward.loss.trace == (False, True, True, True)


def test_a_wrong_csv_trace_names_its_own_lines(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        "at_s,from,to,loss_percent,delay_ms,rate_mbit\n0,a,b,,,\n1,a,b,120,,\nx,a,b,,,\n2,a,z,,,\n"
    )
    path = tmp_path / "s.yaml"
    path.write_text("duration: 5s\nnodes: {a: , b: }\nradio:\n  propagation: {model: table, file: t.csv}\n")
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    where = f"{path}:4: radio.propagation.file: t.csv"
    assert caught.value.problems == [
        f"{where}:3: loss_percent 120 is impossible; it must be 0 to 100",
        f"{where}:4: at_s 'x' is not a number; the column's name gives the unit",
    ]
    (tmp_path / "t.csv").write_text("at_s,from,to,loss_percent,delay_ms,rate_mbit\n2,a,z,5,,\n3,a,z,5,,\n")
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    assert caught.value.problems == [f"{where}:2: node 'z' is not defined; nodes are a, b"]


@pytest.mark.parametrize(
    ("radio", "expected"),
    [
        (
            {"phy": "802.11g-20MHz", "propagation": {"model": "tunnel"}},
            "radio.propagation.model: model tunnel is about tunnels, and there are none; add terrain",
        ),
        ({"propagation": {"model": "subt"}}, "radio: propagation model subt needs a phy; add phy: 802.11g-20MHz"),
        (
            {"driver": "hwsim", "propagation": {"model": "subt"}},
            "radio: propagation model subt has no meaning with driver: hwsim",
        ),
        (
            {"phy": "subt", "rssi": "-50dBm", "propagation": {"model": "subt"}},
            "radio: rssi is what propagation model subt computes",
        ),
        (
            {"phy": "subt", "propagation": {"model": "subt", "tile": "20"}},
            "radio.propagation.tile: 20 has no unit; write a length like 4m",
        ),
        (
            {"phy": "subt", "propagation": {"model": "no_such_module:Salt"}},
            "radio.propagation: propagation model 'no_such_module:Salt': No module named",
        ),
        ({"propagation": {"model": "tunel"}}, "unknown propagation model 'tunel'; did you mean 'tunnel'?"),
        ({"propagation": {"model": "magic"}}, "radio.propagation.model: unknown propagation model 'magic'"),
        ({"propagation": {"model": "none", "pairs": []}}, "radio.propagation: pairs belongs to model: table"),
        ({"propagation": {"model": "table", "default": "far"}}, "write out_of_range or a block of link words"),
        (
            {"propagation": {"model": "none"}, "tx_power": "20dBm"},
            "radio: tx_power belongs to a propagation model that goes by positions (free_space,",
        ),
        ({}, "radio.propagation: is missing; add it"),
        (
            {"propagation": {"model": "table", "pairs": [{"between": ["a", "z"]}]}},
            "pairs[0].between[1]: node 'z' is not",
        ),
        (
            {"propagation": {"model": "table", "pairs": [{"between": ["a", "b"]}, {"from": "b", "to": "a"}]}},
            "pairs[1]: b and a are in the table twice (first in pairs[0]); remove one",
        ),
    ],
)
def test_wrong_radios(radio: dict[str, object], expected: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        scenario(radio=radio)
    [problem] = caught.value.problems
    assert expected in problem


def test_everything_of_the_format_that_is_for_later_is_refused_as_such() -> None:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(
            {
                "duration": "1s",
                "engine": "sim",
                "nodes": {"a": {}, "b": {}},
            }
        )
    late = [problem for problem in caught.value.problems if "not available yet" in problem]
    assert late == caught.value.problems
    assert len(late) == 1
