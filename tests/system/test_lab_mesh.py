"""Nodes in a batman-adv mesh: addresses, routing over hops, the diamond. Needs a kernel with batman-adv."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord
from netlab.errors import MachineError
from netlab.kernel.probe import in_child, try_batman
from netlab.pytest_plugin import MakeLab

TOPOLOGIES = Path(__file__).parents[2] / "topologies"
BATMAN_TYPE = bytes.fromhex("4305")
BATMAN_DIAMOND = ["mesh=batman-adv", "expect[0].max=8s", "expect[1].max=2s", "expect[2].max=18s"]
LINE = {
    "duration": "4s",
    "mesh": "batman-adv",
    "nodes": {"a": {"processes": ["udp_mesh"]}, "r": {}, "b": {"processes": ["udp_mesh"]}},
    "links": [{"between": ["a", "r"], "delay": "2ms"}, {"between": ["r", "b"], "delay": "2ms"}],
    "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "10Hz"}],
}


@pytest.fixture
def batman() -> None:
    problem = in_child(try_batman)
    if problem:
        pytest.skip(f"{problem}; to run this test too: netlab vm --clock virtual -- pytest {Path(__file__).name}")


@pytest.mark.usefixtures("batman")
@pytest.mark.parametrize("algorithm", ["BATMAN_IV", "BATMAN_V"])
def test_messages_cross_a_relay_that_runs_nothing(make_lab: MakeLab, algorithm: str) -> None:
    lab = make_lab(LINE, overrides=[f"batman_adv.routing_algorithm={algorithm}"])
    result = lab.run()
    stream = result.stream("t")
    assert stream["delivered"] == stream["sent"] == 40, result.report()
    assert 0.004 <= stream["latency_s"]["p50"] < 0.005  # both hops
    assert stream["latency_s"]["max"] < 0.1, "t = 0 is when there are routes"
    with Capture.open(lab.capture) as capture:
        packets = [record for record in capture.records({Kind.PACKET}) if isinstance(record, PacketRecord)]
    kinds = {(record.node, record.interface): set[bool]() for record in packets}
    for record in packets:
        kinds[record.node, record.interface].add(record.frame[12:14] == BATMAN_TYPE)
    assert kinds["a", "bat0"] == {False}, "inside the mesh interface frames are plain"
    for member in (("a", "eth0"), ("r", "eth0"), ("r", "eth1"), ("b", "eth0")):
        assert kinds[member] == {True}, "members carry nothing but the mesh"
    assert {name for pair in result.trace.links for _, name in pair} == {"eth0", "eth1"}


@pytest.mark.usefixtures("batman")
def test_only_the_mesh_interface_has_an_address_and_names_mean_it(make_lab: MakeLab) -> None:
    lab = make_lab(LINE)
    told = json.loads(lab.exec("r", "ip", "-json", "address").stdout)
    found = {link["ifname"]: [entry["family"] for entry in link["addr_info"]] for link in told}
    assert found.pop("bat0") == ["inet", "inet6"]
    assert found.pop("lo")
    assert found == {"eth0": [], "eth1": []}
    mtu = {link["ifname"]: link["mtu"] for link in told}
    assert (mtu["bat0"], mtu["eth0"]) == (1500, 1532)
    assert lab.exec("a", "getent", "hosts", "b").stdout.split()[0] == "10.240.0.3"
    patient = "for try in $(seq 60); do ping -c1 -W1 b && exit; done; exit 1"  # until there is a route
    assert lab.exec("a", "sh", "-c", patient, timeout_s=90).returncode == 0
    assert lab.exec("a", "ping", "-c3", "-i0.2", "-Mdo", "-s1472", "b").returncode == 0, "1500 bytes fit"


@pytest.mark.usefixtures("batman")
def test_settings_reach_the_kernel(make_lab: MakeLab) -> None:
    lab = make_lab(LINE, overrides=["batman_adv.originator_interval=200ms", "duration=3s"], packets=True)
    result = lab.run()
    with Capture.open(lab.capture) as capture:
        records = [record for record in capture.records({Kind.PACKET}) if isinstance(record, PacketRecord)]
    # The node's own routing messages: packet type 0, version 15, and a time to live that nobody has counted down.
    own = [
        r for r in records if (r.node, r.interface) == ("a", "eth0") and r.frame[12:17] == BATMAN_TYPE + b"\0\x0f\x32"
    ]
    sent = [record for record in own if record.direction.name == "OUTBOUND"]
    span_s = (sent[-1].t_ns - sent[0].t_ns) / 1e9
    assert 0.17 <= span_s / (len(sent) - 1) <= 0.25, result.report()


@pytest.mark.usefixtures("batman")
def test_the_diamond_meets_its_expectations_and_a_cut_hits(make_lab: MakeLab) -> None:
    result = make_lab(TOPOLOGIES / "relay_diamond.yaml", overrides=BATMAN_DIAMOND).run()
    assert all(row.passed for row in result.expectations), result.report()
    delays = [row["delay_s"] for row in result.summary["reroutes"]]
    assert len(delays) == 2
    assert max(delays) > 0.5, "the cut links carried nothing: nothing was rerouted"


@pytest.mark.usefixtures("batman")
def test_a_slow_mesh_fails_what_the_diamond_asks_of_wnet(make_lab: MakeLab) -> None:
    result = make_lab(TOPOLOGIES / "relay_diamond.yaml", overrides=["mesh=batman-adv"]).run()
    failed = [row.name for row in result.expectations if not row.passed]
    assert "reroute" in {name.split()[0] for name in failed}, result.report()


def test_a_kernel_without_batman_says_what_to_do(make_lab: MakeLab) -> None:
    if in_child(try_batman) is None:
        pytest.skip("this kernel has batman-adv")
    with pytest.raises(MachineError) as caught:
        make_lab(LINE)
    assert re.search(r"mesh: batman-adv needs .* --in vm", str(caught.value))
