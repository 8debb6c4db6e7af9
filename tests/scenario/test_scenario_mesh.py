"""The mesh of a node: who is in which, who reaches whom, what the plan makes of it, which mistakes are found."""

from __future__ import annotations

import pytest

from netlab.engines.plan import compile_plan, hosts
from netlab.errors import ScenarioError
from netlab.medium.meshes import BabelOptions, BatmanOptions, FloodOptions, MeshKind, RoutingAlgorithm
from netlab.scenario import Scenario, parse_scenario
from wnet.config import MEMBER_MTU_BYTES, parse

NODE = {"processes": ["udp_mesh"]}
MESHED = {**NODE, "mesh": "batman-adv"}
LINE = [{"between": ["a", "b"]}, {"between": ["b", "c"]}]


def scenario(**keys: object) -> Scenario:
    filled = {"nodes": {"a": MESHED, "b": MESHED, "c": MESHED}, "links": LINE, **keys}
    return parse_scenario({"duration": "10s", **filled})


def problems(**keys: object) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        scenario(**keys)
    return caught.value.problems


def test_the_top_level_is_the_default_and_a_node_wins() -> None:
    nodes = {"a": {}, "b": {"mesh": "none"}, "c": {}}
    meshed = scenario(mesh="batman-adv", nodes=nodes, links=[])
    assert meshed.meshes == {"a": MeshKind.BATMAN_ADV, "b": None, "c": MeshKind.BATMAN_ADV}
    assert set(scenario(nodes={"a": {}, "b": {}, "c": {}}).meshes.values()) == {None}


def test_a_mesh_reaches_over_hops_and_nothing_else_does() -> None:
    meshed = scenario()
    assert meshed.reaches("a", "c")
    assert not meshed.joined("a", "c")
    plain = scenario(nodes={"a": NODE, "b": NODE, "c": NODE})
    assert (plain.reaches("a", "b"), plain.reaches("a", "c")) == (True, False)


def test_radios_join_a_mesh_and_two_parts_stay_two() -> None:
    nodes = {"a": MESHED, "b": {**MESHED, "radio": "none"}, "c": MESHED, "d": {**MESHED, "radio": "none"}, "e": NODE}
    radio = {"propagation": {"model": "none"}}
    meshed = scenario(nodes=nodes, links=[{"between": ["a", "b"]}], radio=radio)
    assert meshed.reaches("b", "c"), "by wire to a, by radio to c"
    assert not meshed.reaches("a", "d")
    assert meshed.joined("a", "e") == ("radio",)
    assert not meshed.reaches("a", "e"), "one channel, but e does not speak batman-adv"
    assert not meshed.reaches("e", "a")


def test_to_all_means_the_whole_mesh() -> None:
    entry = {"from": "a", "to": "all", "topic": "t", "size": "100B", "rate": "1Hz"}
    assert [stream.destination for stream in scenario(traffic=[entry]).streams()] == ["b", "c"]


def test_members_have_no_address_and_room_for_the_mesh_s_header() -> None:
    plan = compile_plan(scenario(nodes={"a": MESHED, "b": MESHED, "c": MESHED, "d": NODE}))
    assert {(port.address, port.mtu) for port in plan.ports} == {(None, 1532)}
    a, b, c = plan.meshes
    assert [mesh.ports for mesh in (a, b, c)] == [(0,), (1, 2), (3,)]
    assert (b.node, b.ifname, b.address, b.mtu) == ("b", "bat0", "10.240.0.2/16", 1500)
    assert len({mesh.mac for mesh in plan.meshes} | {port.mac for port in plan.ports}) == 7
    assert hosts(plan) == [
        (address, name)
        for place, node in enumerate("abc", start=1)
        for address, name in ((f"10.240.0.{place}", node), (f"10.240.0.{place}", f"{node}-bat0"))
    ]


def test_without_a_mesh_nothing_changes() -> None:
    plan = compile_plan(scenario(nodes={"a": NODE, "b": NODE, "c": NODE}))
    assert plan.meshes == ()
    assert [(port.address, port.mtu) for port in plan.ports][:2] == [("10.1.0.1/24", 1500), ("10.1.0.2/24", 1500)]


def test_batman_settings_lie_over_one_another() -> None:
    top = {"routing_algorithm": "V", "originator_interval": "500ms", "hop_penalty": 15}
    nodes = {
        "a": {**MESHED, "batman_adv": {"originator_interval": "2s", "elp_interval": "250ms"}},
        "b": MESHED,
        "c": MESHED,
    }
    meshed = scenario(batman_adv=top, nodes=nodes)
    assert meshed.batman_options("a") == BatmanOptions(RoutingAlgorithm.BATMAN_V, 2.0, 0.25, 15)
    assert meshed.batman_options("b") == BatmanOptions(RoutingAlgorithm.BATMAN_V, 0.5, None, 15)
    assert scenario().batman_options("a") == BatmanOptions()
    assert compile_plan(meshed).meshes[0].batman == meshed.batman_options("a")


def test_flood_settings_lie_over_one_another_and_its_process_can_be_killed() -> None:
    nodes = {"a": {**NODE, "flood": {"jitter": "1ms"}}, "b": NODE, "c": {"mesh": "none"}}
    kill = {"at": "1s", "kill": {"node": "b", "process": "flood"}, "restart": "1s"}
    meshed = scenario(mesh="flood", flood={"hop_limit": 3}, nodes=nodes, links=LINE[:1], events=[kill])
    assert meshed.flood_options("a") == FloodOptions(3, 0.001)
    assert meshed.flood_options("b") == FloodOptions(3)
    assert [meshed.process_names(node) for node in "abc"] == [("udp_mesh", "flood"), ("udp_mesh", "flood"), ()]
    a, b = compile_plan(meshed).meshes
    assert (a.kind, a.ifname, a.address, a.flood) == (MeshKind.FLOOD, "flood0", "10.240.0.1/16", FloodOptions(3, 0.001))
    assert (b.flood, MeshKind.FLOOD.made_by_kernel, MeshKind.BATMAN_ADV.made_by_kernel) == (
        FloodOptions(3),
        False,
        True,
    )


def test_wnet_settings_are_those_of_its_daemon() -> None:
    nodes = {"a": {"wnet": {"hello_fast": "200ms", "channel": "54mbit"}}, "b": {}, "c": {}}
    meshed = scenario(mesh="wnet", wnet={"metric": "etx", "hello_fast": "50ms"}, nodes=nodes)
    assert meshed.wnet_settings("a") == {"metric": "etx", "hello_fast_s": 0.2, "channel_bps": 54e6}
    assert meshed.wnet_settings("b") == {"metric": "etx", "hello_fast_s": 0.05}
    parse(meshed.wnet_settings("a"), source="a")
    assert compile_plan(meshed).meshes[0].wnet == meshed.wnet_settings("a")
    assert compile_plan(meshed).ports[0].mtu == MEMBER_MTU_BYTES


def test_babel_has_addresses_and_no_interface() -> None:
    nodes: dict[str, dict[str, str]] = {"a": {}, "b": {}, "c": {}}
    meshed = scenario(mesh="babel", babel={"hello_interval": "1s", "wireless": True}, nodes=nodes)
    assert [mesh.address for mesh in compile_plan(meshed).meshes] == [f"10.240.0.{place}/32" for place in (1, 2, 3)]
    assert compile_plan(meshed).meshes[1].babel == BabelOptions(1.0, True)
    assert meshed.process_names("a") == ("babeld",)


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"mesh": "batman"}, "mesh: unknown mesh 'batman'; did you mean 'batman-adv'?"),
        ({"mesh": "babeld"}, "mesh: unknown mesh 'babeld'; did you mean 'babel'?"),
        ({"mesh": "olsr"}, "mesh: unknown mesh 'olsr'; known are none, batman-adv, flood, wnet, babel"),
        ({"mesh": "wnet", "wnet": {"hello_fast": "1ms"}}, "wnet.hello_fast: "),
        ({"mesh": "wnet", "wnet": {"interval": "1s"}}, "wnet.interval: "),
        ({"mesh": "wnet", "wnet": {"key": "secret"}}, "wnet.key: expected 64 hexadecimal digits in quotes"),
        (
            {"mesh": "wnet", "nodes": {"a": {}, "b": {"wnet": {"metric": "etx"}}, "c": {}}},
            "nodes.b.wnet.metric: 'b' goes by etx and 'a' by quality; a mesh needs one and the same",
        ),
        (
            {
                "mesh": "babel",
                "nodes": {"a": NODE, "b": NODE, "c": NODE},
                "traffic": [{"from": "a", "to": "all", "topic": "t", "size": "1kB", "rate": "1Hz"}],
            },
            "traffic[0].to: mesh: babel has no broadcast, which to: all needs; name the nodes",
        ),
        ({"mesh": "flood", "flood": {"jitter": "2s"}}, "flood.jitter: "),
        ({"mesh": "flood", "flood": {"hop_limit": 0}}, "flood.hop_limit: '0' is impossible; it must be at least 1"),
        (
            {"nodes": {"a": MESHED, "b": MESHED, "c": {**MESHED, "flood": {"hop_limit": 1}}}},
            "nodes.c.flood: belongs to mesh: flood, and 'c' has mesh: batman-adv",
        ),
        (
            {"mesh": "flood", "nodes": {"a": {}, "b": {}, "c": {"processes": [{"argv": ["x"], "name": "flood"}]}}},
            "nodes.c.processes: 'flood' is the process that is the node's mesh; give yours another name:",
        ),
        (
            {"mesh": "flood", "events": [{"at": "1s", "kill": {"node": "a", "process": "flood"}}]},
            "node 'a' runs no process 'flood'; its processes are udp_mesh",
        ),
        ({"batman_adv": {"routing_algorithm": "VI"}}, "unknown routing algorithm 'VI'; known are BATMAN_IV, BATMAN_V"),
        ({"batman_adv": {"originator_interval": "10ms"}}, "batman_adv.originator_interval: "),
        ({"batman_adv": {"hop_penalty": 256}}, "batman_adv.hop_penalty: '256' is impossible; it must be at most 255"),
        (
            {"nodes": {"a": MESHED, "b": MESHED, "c": {**NODE, "batman_adv": {"hop_penalty": 1}}}, "links": []},
            "nodes.c.batman_adv: belongs to mesh: batman-adv, and 'c' has mesh: none",
        ),
        (
            {"nodes": {"a": MESHED, "b": MESHED, "c": NODE}},
            "links[1]: 'b' has mesh: batman-adv and 'c' has mesh: none, so neither understands the other; "
            "give both the same mesh",
        ),
        (
            {"nodes": {"a": MESHED, "b": {**MESHED, "batman_adv": {"routing_algorithm": "V"}}, "c": MESHED}},
            "nodes.b.batman_adv.routing_algorithm: 'b' routes by BATMAN_V and 'a' by BATMAN_IV; "
            "a mesh needs one and the same",
        ),
    ],
)
def test_mistakes(keys: dict[str, object], problem: str) -> None:
    found = problems(**keys)
    assert len(found) == 1
    assert problem in found[0]


def traffic(source: str, to: str) -> dict[str, object]:
    return {"from": source, "to": to, "topic": "t", "size": "100B", "rate": "1Hz"}


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        (
            {"nodes": {"a": NODE, "b": NODE, "c": NODE}},
            "share no link or radio, and nothing is routed; join them, or give all between them a mesh",
        ),
        ({"links": [LINE[0]]}, "'a' and 'c' are in two batman-adv meshes that no link or radio joins; join them"),
        (
            {"nodes": {"a": MESHED, "b": MESHED, "c": NODE}, "links": [LINE[0]]},
            "are in different meshes (mesh: batman-adv and mesh: none); give both the same, or none",
        ),
    ],
)
def test_traffic_that_cannot_arrive_is_told_why(keys: dict[str, object], problem: str) -> None:
    [found] = problems(traffic=[traffic("a", "c")], **keys)
    assert found.endswith(problem)


OUTAGE = {"at": "1s", "outage": {"between": ["a", "b"], "for": "2s"}}
REROUTE = {"reroute": {"between": ["a", "c"]}, "max": "1s"}


def test_any_cut_in_the_mesh_serves_reroute_and_reconnect() -> None:
    expect = [REROUTE, {"reconnect": {"between": ["a", "c"]}, "max": "1s"}]
    assert scenario(traffic=[traffic("a", "c")], events=[OUTAGE], expect=expect).expect


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"events": [OUTAGE]}, "no traffic goes between 'a' and 'c', so nothing shows a reroute; add some"),
        (
            {"traffic": [traffic("a", "c")]},
            "nothing is ever cut between 'a' and 'c'; add an outage or a flap to events",
        ),
        (
            {
                "nodes": {"a": NODE, "b": NODE, "c": NODE},
                "events": [OUTAGE, {**OUTAGE, "outage": {**OUTAGE["outage"], "between": ["a", "c"]}}],
                "links": [*LINE, {"between": ["a", "c"]}],
                "traffic": [traffic("a", "c")],
            },
            "nothing is routed between 'a' and 'c'; give them, and what joins them, a mesh:",
        ),
    ],
)
def test_a_reroute_that_cannot_be_asked(keys: dict[str, object], problem: str) -> None:
    [found] = problems(expect=[REROUTE], **keys)
    assert found.endswith(problem)
