"""A plan's meshes on top of its ports; the kernel is a fake."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.engines import mesh_interfaces
from netlab.engines.base import LabPlan
from netlab.engines.plan import compile_plan
from netlab.errors import MachineError
from netlab.scenario import parse_scenario


def plan(mesh: str) -> LabPlan:
    links = [{"between": ["a", "r"]}, {"between": ["r", "b"]}]
    nodes: dict[str, dict[str, str]] = {"a": {}, "r": {}, "b": {}}
    return compile_plan(parse_scenario({"duration": "1s", "mesh": mesh, "nodes": nodes, "links": links}))


def test_every_node_gets_its_interface_with_its_own_members(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[Any, ...]] = []
    monkeypatch.setattr(mesh_interfaces.batman, "create", lambda *order: made.append(order))
    assert mesh_interfaces.bring_up(plan("batman-adv"), {"a": 11, "r": 12, "b": 13}) >= 0
    assert [(fd, ifname, address, members) for fd, ifname, _, address, members, _ in made] == [
        (11, "bat0", "10.240.0.1/16", ["eth0"]),
        (12, "bat0", "10.240.0.2/16", ["eth0", "eth1"]),
        (13, "bat0", "10.240.0.3/16", ["eth0"]),
    ]


def test_a_refusal_names_the_node(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*order: object) -> None:
        raise OSError("mesh interface bat0: no")

    monkeypatch.setattr(mesh_interfaces.batman, "create", refuse)
    with pytest.raises(MachineError, match="node a: mesh interface bat0: no"):
        mesh_interfaces.bring_up(plan("batman-adv"), {"a": 11, "r": 12, "b": 13})


def test_the_kernel_is_asked_only_where_a_mesh_needs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_interfaces, "in_child", lambda trial: "no interface of kind batadv")
    mesh_interfaces.check_kernel(plan("none"))
    with pytest.raises(MachineError, match=r"\(no interface of kind batadv\); load it .* --in vm .*netlab vm build"):
        mesh_interfaces.check_kernel(plan("batman-adv"))
    monkeypatch.setattr(mesh_interfaces, "in_child", lambda trial: None)
    mesh_interfaces.check_kernel(plan("batman-adv"))


def test_a_route_is_missing_until_the_node_knows_the_other_s_address(monkeypatch: pytest.MonkeyPatch) -> None:
    meshed = plan("batman-adv")
    macs = {mesh.node: mesh.mac for mesh in meshed.meshes}
    known = {11: {macs["b"]}, 13: set[bytes]()}
    monkeypatch.setattr(mesh_interfaces.batman, "routed", lambda fd: known[fd])
    fds, wanted = {"a": 11, "r": 12, "b": 13}, [("a", "b"), ("b", "a")]
    assert mesh_interfaces.missing_routes(meshed, fds, wanted) == {("b", "a")}
    known[13] = {macs["a"], macs["r"]}
    assert mesh_interfaces.missing_routes(meshed, fds, wanted) == set()
    assert mesh_interfaces.missing_routes(plan("none"), fds, wanted) == set()
