"""A plan's meshes on top of its ports; the kernel is a fake."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from netlab.engines import mesh_interfaces
from netlab.engines.base import LabPlan
from netlab.engines.plan import compile_plan
from netlab.errors import MachineError
from netlab.scenario import parse_scenario


def plan(mesh: str, **keys: object) -> LabPlan:
    links = [{"between": ["a", "r"]}, {"between": ["r", "b"]}]
    nodes: dict[str, dict[str, str]] = {"a": {}, "r": {}, "b": {}}
    return compile_plan(parse_scenario({"duration": "1s", "mesh": mesh, "nodes": nodes, "links": links, **keys}))


def test_every_node_gets_its_interface_with_its_own_members(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[Any, ...]] = []
    monkeypatch.setattr(mesh_interfaces.batman, "create", lambda *order: made.append(order))
    assert mesh_interfaces.bring_up(plan("batman-adv"), {"a": 11, "r": 12, "b": 13}) >= 0
    assert [(fd, ifname, address, members) for fd, ifname, _, address, members, _ in made] == [
        (11, "bat0", "10.240.0.1/16", ["eth0"]),
        (12, "bat0", "10.240.0.2/16", ["eth0", "eth1"]),
        (13, "bat0", "10.240.0.3/16", ["eth0"]),
    ]


def test_a_mesh_that_is_a_process_gets_a_tap_and_the_process_its_members(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    made: list[tuple[Any, ...]] = []
    monkeypatch.setattr(mesh_interfaces.taps, "create", lambda *order: made.append(order))
    flooded = plan("flood", radio={"propagation": {"model": "none"}}, flood={"jitter": "2ms"})
    mesh_interfaces.bring_up(flooded, {"a": 11, "r": 12, "b": 13})
    assert made == [
        (fd, "flood0", mesh.mac, f"10.240.0.{place}/16", 1500)
        for place, (fd, mesh) in enumerate(zip((11, 12, 13), flooded.meshes, strict=True), start=1)
    ]
    _, relay, _ = mesh_interfaces.processes(flooded, tmp_path)
    assert (relay.node, relay.name, relay.argv[0]) == ("r", "flood", "netlab-flood")
    words = dict(zip(relay.argv[1::2], relay.argv[2::2], strict=True))
    assert (words["--radio"], words["--jitter"], words["--hop-limit"]) == ("radio0", "0.002", "64")
    assert [relay.argv[at + 1] for at, word in enumerate(relay.argv) if word == "--wire"] == ["eth0", "eth1"]
    assert mesh_interfaces.processes(plan("batman-adv"), tmp_path) == []


def test_a_wnet_daemon_gets_a_file_and_where_there_is_no_tap_a_veth(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    made: list[tuple[Any, ...]] = []
    monkeypatch.setattr(mesh_interfaces.taps, "create_veth", lambda *order: made.append(order))
    monkeypatch.setattr(mesh_interfaces, "in_child", lambda trial: "not permitted")
    radio = {"phy": "802.11g-20MHz", "propagation": {"model": "none"}}
    wnet = mesh_interfaces.fitted(plan("wnet", radio=radio, wnet={"hello_slow": "1s", "key": "ab" * 32}))
    assert not any(port.radiotap for port in wnet.ports), "nobody plays a radio in monitor mode without a TAP"
    mesh_interfaces.bring_up(wnet, {"a": 11, "r": 12, "b": 13})
    assert [order[:2] for order in made] == [(11, "wnet0"), (12, "wnet0"), (13, "wnet0")]
    _, relay, _ = mesh_interfaces.processes(wnet, tmp_path)
    assert (relay.name, relay.argv[:2], relay.says_ready) == ("wnet", ("wnet-daemon", "--config"), True)
    file = Path(relay.argv[2])
    assert file.stat().st_mode & 0o077 == 0, "it holds the key"
    told = tomllib.loads(file.read_text())
    assert told["mesh"] == {"hello_slow_s": 1.0, "key": "ab" * 32}
    assert [(member["interface"], member["radio"]) for member in told["members"]] == [
        ("eth0", False),
        ("eth1", False),
        ("radio0", True),
    ]


def test_radios_of_wnet_that_share_airtime_are_in_monitor_mode(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(mesh_interfaces, "in_child", lambda trial: None)
    radio = {"phy": "802.11g-20MHz", "propagation": {"model": "none"}}
    wnet = mesh_interfaces.fitted(plan("wnet", radio=radio))
    assert [port.radiotap for port in wnet.ports] == [port.ifname == "radio0" for port in wnet.ports]
    assert not any(port.radiotap for port in plan("flood", radio=radio).ports)
    assert not any(port.radiotap for port in plan("wnet", radio={"propagation": {"model": "none"}}).ports)
    process, *_ = mesh_interfaces.processes(wnet, tmp_path)
    *_, member = tomllib.loads(Path(process.argv[2]).read_text())["members"]
    assert member["rates_bps"] == [rate * 10**6 for rate in (6, 9, 12, 18, 24, 36, 48, 54)]


def no_process(_node: str, _name: str) -> int:
    raise AssertionError("only wnet is asked")


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
    with pytest.raises(MachineError, match=r"mesh: flood needs /dev/net/tun .* access to /dev/net/tun, or .* --in vm"):
        mesh_interfaces.check_kernel(plan("flood"))
    monkeypatch.setattr(mesh_interfaces.babel, "program", lambda: None)
    with pytest.raises(MachineError, match="mesh: babel needs the program babeld; install it: sudo apt-get install"):
        mesh_interfaces.check_kernel(plan("babel"))
    monkeypatch.setattr(mesh_interfaces, "in_child", lambda trial: None)
    mesh_interfaces.check_kernel(plan("flood"))
    mesh_interfaces.check_kernel(plan("batman-adv"))


def test_a_route_is_missing_until_the_node_knows_the_other_s_address(monkeypatch: pytest.MonkeyPatch) -> None:
    meshed = plan("batman-adv")
    macs = {mesh.node: mesh.mac for mesh in meshed.meshes}
    known = {11: {macs["b"]}, 13: set[bytes]()}
    monkeypatch.setattr(mesh_interfaces.batman, "routed", lambda fd: known[fd])
    fds, wanted = {"a": 11, "r": 12, "b": 13}, [("a", "b"), ("b", "a")]
    assert mesh_interfaces.missing_routes(meshed, fds, no_process, wanted) == {("b", "a")}
    known[13] = {macs["a"], macs["r"]}
    assert mesh_interfaces.missing_routes(meshed, fds, no_process, wanted) == set()
    assert mesh_interfaces.missing_routes(plan("none"), fds, no_process, wanted) == set()
