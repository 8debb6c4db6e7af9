"""Nodes whose mesh is Debian's babeld: addresses, routes over hops, messages."""

from __future__ import annotations

import json
from typing import Any

import pytest

from netlab.kernel import babel
from netlab.pytest_plugin import MakeLab

LINE: dict[str, Any] = {
    "duration": "3s",
    "mesh": "babel",
    "babel": {"hello_interval": "500ms"},
    "nodes": {"a": {"processes": ["udp_mesh"]}, "r": {}, "b": {"processes": ["udp_mesh"]}},
    "links": [{"between": ["a", "r"], "delay": "2ms"}, {"between": ["r", "b"], "delay": "2ms"}],
    "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "10Hz"}],
}


@pytest.fixture(autouse=True)
def babeld() -> None:
    if babel.program() is None:
        pytest.skip("babeld is not installed; to run this test too: sudo apt-get install babeld")


def test_messages_cross_a_relay_that_routes(make_lab: MakeLab) -> None:
    lab = make_lab(LINE)
    result = lab.run()
    stream = result.stream("t")
    assert stream["delivered"] == stream["sent"] == 30, result.report()
    assert stream["latency_s"]["p50"] >= 0.004, "both hops"
    assert lab.exec("a", "getent", "hosts", "b").stdout.split()[0] == "10.240.0.3"
    [route] = json.loads(lab.exec("a", "ip", "-json", "route", "show", "10.240.0.3").stdout)
    assert (route["gateway"], route["dev"], route["protocol"]) == ("10.240.0.2", "eth0", "babel")
    told = json.loads(lab.exec("r", "ip", "-json", "-4", "address").stdout)
    addresses = {row["ifname"]: [(a["local"], a["prefixlen"]) for a in row["addr_info"]] for row in told}
    assert addresses["eth0"] == addresses["eth1"] == [("10.240.0.2", 32)]


def test_programs_are_told_of_no_mesh_interface(make_lab: MakeLab) -> None:
    node = {
        "processes": [{"argv": ["sh", "-c", 'echo "interface=$NETLAB_MESH_INTERFACE."; exec sleep 60'], "name": "p"}]
    }
    lab = make_lab({**LINE, "traffic": [], "nodes": {**LINE["nodes"], "r": node}})
    lab.run()
    assert "interface=." in lab.log("r", "p")
