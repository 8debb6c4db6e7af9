"""Radios of a node's own: what they take over, which channel they are on, and what cannot be."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.engines.plan import compile_plan
from netlab.errors import ScenarioError
from netlab.lab.links import Links
from netlab.scenario import Scenario, parse_scenario
from netlab.timeline import SetOutage, compile_timeline
from netlab.world.antenna import omni

RADIO = {"phy": "802.11g-20MHz", "rate": "6mbit", "noise": "-90dBm", "propagation": {"model": "free_space"}}
FAST = {"frequency": "5.18GHz", "phy": "802.11n-20MHz-2x2"}


def scenario(nodes: dict[str, Any], **top: Any) -> Scenario:
    return parse_scenario({"duration": "5s", "radio": RADIO, "nodes": nodes} | top)


def problems(nodes: dict[str, Any], **top: Any) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        scenario(nodes, **top)
    return list(caught.value.problems)


def marsupial(**top: Any) -> Scenario:
    """A base, a carrier with a second radio, and a robot that has only that kind."""
    return scenario({"base": {}, "parent": {"radio": [{}, FAST]}, "uav": {"radio": FAST}}, **top)


def test_what_is_left_out_is_as_in_the_scenarios_block() -> None:
    checked = scenario(
        {"a": {"radio": {"tx_power": "33dBm"}}, "b": {}, "c": {"radio": "none"}, "d": {"radio": [{}, FAST]}}
    )
    [own] = checked.radios("a")
    assert (own.tx_power_dbm, own.phy, own.rate_bps, own.noise_dbm) == (33.0, "802.11g-20MHz", 6e6, -90.0)
    assert checked.radios("b")[0].tx_power_dbm == 20.0
    assert checked.radios("c") == ()
    first, second = checked.radios("d")
    assert first == checked.radios("b")[0]
    assert (second.phy, second.rate_bps, second.frequency_hz) == ("802.11n-20MHz-2x2", None, 5.18e9)


def test_an_antenna_is_named_by_its_gain_or_in_full_and_a_nodes_own_wins() -> None:
    sector = {"gain": "9dBi", "beamwidth": "60deg"}
    nodes = {"a": {"radio": {"antenna": sector}}, "b": {"radio": {"antenna_gain": "7dBi"}}, "c": {}}
    checked = scenario(nodes, radio={**RADIO, "antenna_gain": "5dBi"})
    assert [checked.radios(name)[0].antenna.gain_dbi for name in "abc"] == [9.0, 7.0, 5.0]
    assert [checked.radios(name)[0].antenna.beamwidth_deg for name in "abc"] == [60.0, None, None]
    assert checked.radios("b")[0].antenna.antenna() == omni(7.0)
    [problem] = problems({"a": {"radio": {"antenna": "omni", "antenna_gain": "3dBi"}}})
    assert "nodes.a.radio: antenna says all about it; put the gain there, or remove antenna_gain" in problem


def test_every_frequency_is_a_channel_with_a_subnet_of_its_own() -> None:
    plan = compile_plan(marsupial())
    ports = {(port.node, port.ifname): port for port in plan.ports}
    assert {name: port.address for name, port in ports.items()} == {
        ("base", "radio0"): "10.200.0.1/16",
        ("parent", "radio0"): "10.200.0.2/16",
        ("parent", "radio1"): "10.201.0.2/16",
        ("uav", "radio0"): "10.201.0.3/16",
    }
    mesh, fast = plan.segments
    assert [plan.ports[port].node for port in mesh.ports] == ["base", "parent"]
    assert [plan.ports[port].node for port in fast.ports] == ["parent", "uav"]
    assert (mesh.name, fast.name) == ("radio", "radio-5180MHz")
    assert mesh.channel is not None
    assert fast.channel is not None
    assert (mesh.channel.phy, mesh.channel.rate_bps, mesh.channel.noise_dbm) == ("802.11g-20MHz", 6e6, -90.0)
    assert (fast.channel.phy, fast.channel.rate_bps) == ("802.11n-20MHz-2x2", None)


def test_nodes_are_joined_by_a_frequency_that_they_share() -> None:
    checked = marsupial()
    assert checked.joined("base", "parent") == checked.joined("parent", "uav") == ("radio",)
    assert checked.joined("base", "uav") == ()
    assert not checked.reaches("base", "uav")
    meshed = marsupial(mesh="flood")
    assert meshed.reaches("base", "uav")
    apart = scenario({"a": {}, "b": {"radio": FAST}, "c": {}, "d": {"radio": FAST}}, mesh="flood")
    assert apart.reaches("a", "c")
    assert apart.reaches("b", "d")
    assert not apart.reaches("a", "b")


def test_an_outage_takes_every_radio_of_the_two_nodes() -> None:
    two = {"radio": [{"antenna": {"beamwidth": "60deg"}}, {"antenna": {"beamwidth": "60deg", "facing": "back"}}]}
    event = {"at": "1s", "outage": {"between": ["a", "b"], "for": "1s"}}
    checked = scenario({"a": two, "b": two, "c": {}}, mesh="flood", events=[event])
    plan = compile_plan(checked)
    assert len(plan.segments[0].ports) == 5
    begin, end = compile_timeline(checked, plan)
    for entry in (begin, end):
        assert isinstance(entry.action, SetOutage)
        assert entry.action.pairs == {pair for a in (0, 1) for b in (2, 3) for pair in ((a, b), (b, a))}


def test_links_speak_of_all_radios_between_two_nodes() -> None:
    plan = compile_plan(marsupial())
    links = Links(plan, None)  # type: ignore[arg-type]
    assert links.between("parent", "uav")[0] == {(2, 3), (3, 2)}


@pytest.mark.parametrize(
    ("nodes", "expected"),
    [
        ({"a": {"radio": [{"antenna": {"gain": 3}}]}}, "nodes.a.radio[0].antenna.gain: 3 has no unit"),
        ({"a": {"radio": {"power": "3dBm"}}}, "nodes.a.radio.power: unknown key 'power'"),
        ({"a": {"radio": [{}] * 9}}, "nodes.a.radio: a node has 1 to 8 radios"),
        ({"a": {"radio": "off"}}, "nodes.a.radio: 'off' is not possible here; write none, or a block"),
        ({"a": {"radio": [{}, {}]}}, "nodes.a.radio[1]: two radios of one node on one frequency need a mesh"),
        (
            {"a": {}, "b": {"radio": {"noise": "-80dBm"}}},
            "nodes.b.radio: 'a' has another phy, rate or noise on 2437MHz",
        ),
        ({"a": {"radio": {**FAST, "rate": "7mbit"}}}, "nodes.a.radio: rate: 802.11n-20MHz-2x2 has no rate of 7mbit"),
    ],
)
def test_radios_that_cannot_be(nodes: dict[str, Any], expected: str) -> None:
    [problem] = problems(nodes)
    assert expected in problem


def test_there_are_subnets_for_forty_frequencies() -> None:
    nodes = {f"n{k}": {"radio": {"frequency": f"{5000 + 20 * k}MHz"}} for k in range(41)}
    assert any("there are 41 frequencies; the most is 40" in problem for problem in problems(nodes))
    del nodes["n40"]
    assert compile_plan(scenario(nodes)).ports[39].address == "10.239.0.40/16"


def test_a_mistake_in_the_radio_is_the_only_one_told() -> None:
    """Who is joined by radios that do not validate is not known, so nothing is said of it."""
    udp_mesh = {"processes": ["udp_mesh"]}
    traffic = [{"from": "a", "to": "b", "topic": "t", "size": "1kB", "rate": "1Hz"}]
    wrong = {**RADIO, "propagation": {"model": "free_space", "shadowing": 3}}
    [problem] = problems({"a": udp_mesh, "b": udp_mesh}, traffic=traffic, radio=wrong)
    assert "radio.propagation.shadowing: 3 has no unit" in problem
