"""Fixed neighbours and teams of udp_mesh in scenario files: names there; for the daemon addresses, or names again."""

from __future__ import annotations

import pytest

from netlab.errors import ScenarioError
from netlab.lab.programs import daemon_config
from netlab.scenario import Scenario, parse_scenario


def scenario(**keys: object) -> Scenario:
    return parse_scenario(
        {
            "duration": "1s",
            "nodes": {name: {"processes": ["udp_mesh"]} for name in ("a", "b", "c")},
            "links": [{"between": ["a", "b"]}, {"between": ["b", "c"]}],
            **keys,
        }
    )


def test_names_become_the_addresses_on_shared_links() -> None:
    read = scenario(udp_mesh={"neighbours": ["a", "b", "c"]})
    assert daemon_config(read, "a")["neighbours"] == ["10.1.0.2"]
    assert daemon_config(read, "b")["neighbours"] == ["10.1.0.1", "10.1.1.2"]
    assert "neighbours" not in daemon_config(scenario(), "a")


def test_in_a_mesh_they_are_its_addresses() -> None:
    read = scenario(udp_mesh={"neighbours": ["a", "c"]}, mesh="batman-adv")
    assert daemon_config(read, "a")["neighbours"] == ["10.240.0.3"]


def test_who_cannot_be_a_neighbour_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"udp_mesh\.neighbours\[0\]: node 'd' is not defined"):
        scenario(udp_mesh={"neighbours": ["d"]})
    nodes = {name: {"processes": ["udp_mesh"]} for name in ("b", "c")}
    nodes["a"] = {"processes": ["udp_mesh"], "udp_mesh": {"neighbours": ["c"]}}  # type: ignore[dict-item]
    with pytest.raises(ScenarioError, match=r"nodes\.a\.udp_mesh\.neighbours\[0\]: 'a' and 'c' share no link"):
        scenario(nodes=nodes)


def test_a_team_is_told_by_name_whoever_is_near() -> None:
    read = scenario(udp_mesh={"team": ["a", "c"]}, links=[{"between": ["a", "b"]}])
    assert list(daemon_config(read, "a")["team"]) == ["a", "c"]
    assert "team" not in daemon_config(scenario(), "a")


def test_who_does_not_exist_is_in_no_team() -> None:
    with pytest.raises(ScenarioError, match=r"udp_mesh\.team\[1\]: node 'd' is not defined"):
        scenario(udp_mesh={"team": ["a", "d"]})
    nodes = {name: {"processes": ["udp_mesh"]} for name in ("b", "c")}
    nodes["a"] = {"processes": ["udp_mesh"], "udp_mesh": {"team": ["e"]}}  # type: ignore[dict-item]
    with pytest.raises(ScenarioError, match=r"nodes\.a\.udp_mesh\.team\[0\]: node 'e' is not defined"):
        scenario(nodes=nodes)
