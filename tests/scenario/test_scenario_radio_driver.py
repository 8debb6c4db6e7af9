"""`radio: {driver: hwsim}`: its keys, the words that it lacks, and the plan that it makes."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.engines.hwsim import has_wifi, wires_of
from netlab.engines.plan import compile_plan
from netlab.errors import ScenarioError
from netlab.lab.programs import reach
from netlab.medium.impairments import PERFECT
from netlab.medium.segments import Wifi, WifiMode
from netlab.scenario import parse_scenario
from netlab.scenario.model import Scenario
from netlab.timeline import SetPairs, compile_timeline

NONE = {"model": "none"}


def scenario(radio: dict[str, Any], **more: Any) -> Scenario:
    return parse_scenario({"duration": "9s", "nodes": {"a": {}, "b": {}, "c": {}}, "radio": radio, **more})


def problems(radio: dict[str, Any], **more: Any) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        scenario(radio, **more)
    return [problem.partition(": ")[2] for problem in caught.value.problems]


def test_the_settings_arrive_in_the_plan() -> None:
    keys = {"mode": "ibss", "ssid": "team", "frequency": "5.18GHz", "retry_limit": 4, "monitor": True}
    plan = compile_plan(scenario({"driver": "hwsim", "propagation": NONE, **keys}))
    [segment] = plan.segments
    assert segment.wifi == Wifi(WifiMode.IBSS, "team", 5180, 4, True)
    [default] = compile_plan(scenario({"driver": "hwsim", "propagation": NONE})).segments
    assert default.wifi == Wifi(WifiMode.MESH, "netlab", 2412, 7, False)
    [engine] = compile_plan(scenario({"propagation": NONE})).segments
    assert engine.wifi is None


def test_radios_come_last_so_that_the_wires_keep_their_numbers() -> None:
    links = [{"between": ["a", "b"], "delay": "2ms"}, {"between": ["b", "c"]}]
    plan = compile_plan(scenario({"driver": "hwsim", "propagation": NONE}, links=links))
    assert [(port.index, port.node, port.ifname) for port in plan.ports[4:]] == [
        (4, "a", "radio0"),
        (5, "b", "radio0"),
        (6, "c", "radio0"),
    ]
    assert plan.ports[6].address == "10.200.0.3/16"
    wires = wires_of(plan)
    assert (wires.nodes, wires.ports, wires.segments) == (plan.nodes, plan.ports[:4], plan.segments[:2])
    assert has_wifi(plan)
    assert not has_wifi(wires)


def test_strength_is_a_word_of_a_pair_and_of_an_event() -> None:
    table = {"model": "table", "pairs": [{"between": ["a", "b"], "rssi": "-71dBm"}, {"from": "b", "to": "c"}]}
    radio = {"driver": "hwsim", "rssi": "-60dBm", "propagation": table}
    checked = scenario(radio, events=[{"at": "1s", "link": {"from": "b", "to": "c", "rssi": "-80dBm"}}])
    plan = compile_plan(checked)
    assert {pair: imp.rssi_dbm for pair, imp in plan.segments[0].pairs.items()} == {
        (0, 1): -71,
        (1, 0): -71,
        (1, 2): -60,
    }
    [entry] = compile_timeline(checked, plan)
    assert isinstance(entry.action, SetPairs)
    assert entry.action.changes[1, 2] is not None
    assert entry.action.changes[1, 2].rssi_dbm == -80
    assert entry.label == "link b->c: rssi -80dBm"
    assert PERFECT.rssi_dbm is None


@pytest.mark.parametrize(
    ("radio", "expected"),
    [
        ({"mode": "mesh"}, "radio: mode belongs to 802.11 radios; add driver: hwsim or remove it"),
        ({"rssi": "-60dBm"}, "radio: rssi belongs to 802.11 radios; add driver: hwsim or remove it"),
        ({"frequency": "2412MHz"}, "radio: frequency belongs to a propagation model that goes by positions"),
        ({"driver": "hwsim", "ssid": "x"}, "radio: ssid names an ad-hoc network, and this is a mesh; write mesh_id"),
        ({"driver": "hwsim", "mode": "ibss", "mesh_id": "x"}, "radio: mesh_id names a mesh, and this is an ad-hoc"),
        ({"driver": "hwsim", "mesh_id": "x" * 33}, "radio.mesh_id: expected a name of 1 to 32 bytes"),
        ({"driver": "hwsim", "frequency": "2413MHz"}, "radio.frequency: 2413MHz is not the centre of a channel"),
        ({"driver": "hwsim", "frequency": "2484MHz"}, "radio.frequency: 2484MHz is not the centre of a channel"),
        ({"driver": "hwsim", "retry_limit": 0}, "radio.retry_limit: '0' is impossible; it must be at least 1"),
        ({"driver": "hwsim", "rssi": "-70"}, "radio.rssi: -70 has no unit; write a power like -95dBm"),
        ({"driver": "hwsim", "rssi": "5dBm"}, "radio.rssi: '5dBm' is impossible"),
        ({"driver": "hwsim", "corrupt": "1%"}, "radio.corrupt: corrupt has no meaning between 802.11 radios"),
        ({"driver": "ath9k"}, "radio.driver: 'ath9k' is not possible here; use engine or hwsim"),
    ],
)
def test_wrong_drivers(radio: dict[str, Any], expected: str) -> None:
    [problem] = problems({"propagation": NONE, **radio})
    assert expected in problem


def test_words_that_cannot_be_obeyed_are_found_wherever_they_stand() -> None:
    table = {"model": "table", "pairs": [{"between": ["a", "b"], "reorder": "2%", "delay": "1ms"}]}
    found = problems(
        {"driver": "hwsim", "propagation": table},
        links=[{"between": ["b", "c"], "rssi": "-50dBm"}],
        events=[
            {"at": "1s", "link": {"between": ["a", "b"], "duplicate": "2%"}},
            {"at": "1s", "link": {"between": ["b", "c"], "over": "wire", "rssi": "-50dBm"}},
        ],
    )
    assert {problem.partition(":")[0] for problem in found} == {
        "radio.propagation.pairs[0].reorder",
        "links[0].rssi",
        "events[0].link.duplicate",
        "events[1].link.rssi",
    }


def test_over_a_wire_or_a_radio_of_the_engine_these_words_stay() -> None:
    scenario({"duplicate": "1%", "propagation": NONE})
    links = [{"between": ["a", "b"], "duplicate": "1%"}]
    events = [{"at": "1s", "link": {"between": ["a", "b"], "over": "wire", "corrupt": "1%"}}]
    scenario({"driver": "hwsim", "propagation": NONE}, links=links, events=events)


@pytest.mark.parametrize(("mode", "reached"), [("mesh", {"b", "c"}), ("ibss", {"b"})])
def test_sources_wait_for_what_the_radios_path_selection_reaches(mode: str, reached: set[str]) -> None:
    table = {"model": "table", "pairs": [{"between": ["a", "b"]}, {"between": ["b", "c"]}]}
    checked = scenario({"driver": "hwsim", "mode": mode, "propagation": table})
    assert reach(checked, compile_plan(checked), "a") == reached
