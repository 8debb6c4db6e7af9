"""Nodes in a wnet mesh: programs that know nothing of it, its command, its death, other teams and their forgeries."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml

from netlab.capture import wnet
from netlab.capture.schemas import Direction
from netlab.pytest_plugin import MakeLab
from tests.system.mesh_lines import check_wrapping, end_process, line, line_with_a_killed_relay, recorded
from wnet.core.wire import ETHERTYPE
from wnet.io import radiotap

PROGRAMS = Path(__file__).with_name("wnet_programs.py")
LINE = line("wnet")
#: Noise is at -91 dBm: 31 dB is enough for 54 Mbit/s, 11 dB for some 12 Mbit/s.
HEARD = [{"between": ["a", "r"], "rssi": "-60dBm"}, {"between": ["r", "b"], "rssi": "-80dBm"}]
BY_RADIO: dict[str, Any] = {
    **LINE,
    "links": [],
    "radio": {"phy": "802.11g-20MHz", "propagation": {"model": "table", "pairs": HEARD}},
}
QUIET = {**LINE, "traffic": [], "nodes": {"a": {}, "r": {}, "b": {}}}
PATIENT = "for try in $(seq 50); do ping -c1 -W1 b && exit; done; exit 1"


def test_messages_cross_a_relay_and_the_capture_tells_all(make_lab: MakeLab) -> None:
    lab = make_lab(LINE)
    result = lab.run()
    stream = result.stream("t")
    assert stream["delivered"] == stream["sent"] == 40, result.report()
    assert stream["duplicates"] == 0
    assert stream["latency_s"]["p50"] >= 0.004, "both hops"
    packets, events = recorded(lab)
    check_wrapping(packets, "wnet0", ETHERTYPE)
    told = [event for event in events if event.topic == "/r/wnet/events"]
    links = {event.payload["neighbour"] for event in told if event.text("event") == "link_up"}
    assert links == {"02:4e:4d:00:00:01", "02:4e:4d:00:00:03"}
    assert any(event.text("event") == "stats" and event.payload.get("relayed") for event in told)


def test_the_kernel_s_own_programs_work_over_it(make_lab: MakeLab) -> None:
    lab = make_lab(LINE)
    told = json.loads(lab.exec("r", "ip", "-json", "address").stdout)
    found = {link["ifname"]: [entry["family"] for entry in link["addr_info"]] for link in told}
    assert found.pop("wnet0") == ["inet", "inet6"]
    assert found["eth0"] == found["eth1"] == []
    assert lab.exec("a", "getent", "hosts", "b").stdout.split()[0] == "10.240.0.3"
    assert lab.exec("a", "sh", "-c", PATIENT).returncode == 0
    whole = lab.exec("a", "ping", "-c3", "-i0.2", "-Mdo", "-s1472", "b")
    assert whole.returncode == 0, whole.stdout
    six = lab.exec("a", "sh", "-c", "ping -6 -c2 -i0.2 fe80::4e:4dff:fe00:3%wnet0")
    assert six.returncode == 0, six.stdout


def test_a_transfer_by_tcp_arrives_whole(make_lab: MakeLab) -> None:
    lab = make_lab(QUIET)
    assert lab.exec("a", "sh", "-c", PATIENT).returncode == 0
    served = lab.spawn("b", sys.executable, "-m", "http.server", "--directory", str(Path(sys.prefix) / "bin"), "8000")
    fetch = lab.exec("a", sys.executable, str(PROGRAMS), "fetch", "http://b:8000/activate")
    served.close()
    assert fetch.stdout == (Path(sys.prefix) / "bin" / "activate").read_text(), fetch.stderr


def test_multicast_goes_where_a_listener_is(make_lab: MakeLab) -> None:
    """A line of five: b listens, d and e behind it do not, so nothing is sent to them."""
    names = ["a", "r", "b", "d", "e"]
    links = [{"between": [x, y]} for x, y in pairwise(names)]
    lab = make_lab({**QUIET, "nodes": {name: {} for name in names}, "links": links})
    assert lab.exec("a", "sh", "-c", PATIENT).returncode == 0
    listener = lab.spawn("b", sys.executable, str(PROGRAMS), "listen", "239.1.2.3", "10.240.0.3", "10")
    sent = lab.exec("a", sys.executable, str(PROGRAMS), "send", "239.1.2.3", "10.240.0.1", "10")
    assert sent.returncode == 0, sent.stderr
    assert listener.next_reply(timeout_s=30)["exit"] == 0, "ten came, each once"
    listener.close()
    lab.close()
    packets, _ = recorded(lab)
    group = bytes.fromhex("01005e010203")
    frames = [(r, r.frame if r.interface == "wnet0" else wnet.inner_frame(r.frame, 14)) for r in packets]
    where = Counter((r.node, r.interface) for r, inner in frames if inner is not None and inner[:6] == group)
    assert where["b", "wnet0"] == 10
    assert {node for node, _ in where} == {"a", "r", "b"}, "nothing goes to those who do not listen"


def test_the_command_tells_links_routes_and_topology(make_lab: MakeLab) -> None:
    lab = make_lab(QUIET)
    assert lab.exec("a", "sh", "-c", PATIENT).returncode == 0
    routes = json.loads(lab.exec("a", "wnet", "routes", "--json").stdout)
    assert {(row["destination"], row["next_hop"], row["hops"]) for row in routes["routes"]} == {
        ("02:4e:4d:00:00:02", "02:4e:4d:00:00:02", 1),
        ("02:4e:4d:00:00:03", "02:4e:4d:00:00:02", 2),
    }
    table = lab.exec("a", "wnet", "routes").stdout.splitlines()
    assert re.match(r"10\.240\.0\.3 +10\.240\.0\.2 +2 ", table[-1])
    dot = lab.exec("a", "wnet", "topology", "--dot").stdout
    assert dot.startswith("digraph wnet_topology {")
    assert '"10.240.0.3" -> "10.240.0.2"' in dot
    links = json.loads(lab.exec("r", "wnet", "links", "--json").stdout)["links"]
    assert sorted(link["member"] for link in links) == [0, 1]
    lost = lab.exec("a", "wnet", "--socket", "/run/none.sock", "links")
    assert (lost.returncode, "no daemon at /run/none.sock" in lost.stderr) == (1, True)
    second = lab.exec("a", "wnet", "daemon", "--config", "/run/none.toml")
    assert (second.returncode, second.stderr) == (2, "wnet: /run/none.toml: No such file or directory\n")


def test_a_daemon_that_was_killed_works_again_after_its_restart(make_lab: MakeLab) -> None:
    result = make_lab(line_with_a_killed_relay("wnet"), packets=False).run()
    assert not result.problems, result.report()
    assert result.stream("t")["delivered"] == 60, result.report()
    assert result.stream("t")["longest_gap_s"] >= 0.3, "it was away"


def test_its_end_is_reported(make_lab: MakeLab) -> None:
    lab = make_lab(LINE)
    end_process(lab, "r", "wnet")
    result = lab.finish()
    assert any(re.match(r"r: process 'wnet' was ended by SIGKILL", text) for text in result.problems)


@pytest.mark.parametrize("scenario", [LINE, BY_RADIO], ids=["wires", "radio"])
def test_who_has_no_taps_gets_a_veth(tmp_path: Path, need_tool: Callable[[str], str], scenario: dict[str, Any]) -> None:
    """As where an ordinary user may not use /dev/net/tun: in a user namespace of its own, with another file there."""
    file = tmp_path / "line.yaml"
    file.write_text(yaml.safe_dump({**scenario, "name": "line"}))
    hidden = 'mount --bind /dev/null /dev/net/tun && exec "$@"'
    argv = [need_tool("unshare"), "--user", "--map-root-user", "--mount", "sh", "-c", hidden, "sh"]
    run = [sys.executable, "-m", "netlab", "run", str(file), "--json"]
    with tempfile.TemporaryDirectory(prefix="wnet-") as runtime:  # short: there are sockets in it
        env = {**os.environ, "NETLAB_RUNTIME_DIR": runtime}
        words = [*argv, *run]
        done = subprocess.run(words, env=env, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    [stream] = json.loads(done.stdout)["streams"]
    assert stream["delivered"] == stream["sent"] == 40


def test_a_node_without_links_is_a_mesh_of_its_own(make_lab: MakeLab) -> None:
    lab = make_lab({**QUIET, "nodes": {**QUIET["nodes"], "z": {}}}, packets=False)
    assert json.loads(lab.exec("z", "wnet", "links", "--json").stdout)["links"] == []


@pytest.mark.usefixtures("taps")
def test_by_radio_signals_and_rates_are_real(make_lab: MakeLab) -> None:
    lab = make_lab(BY_RADIO)
    result = lab.run()
    assert result.stream("t")["delivered"] == result.stream("t")["sent"] == 40, result.report()
    packets, _ = recorded(lab)
    on_air = [record for record in packets if record.interface == "radio0"]
    assert {record.linktype for record in on_air} == {127}
    heard = {node: set[float | None]() for node in "arb"}
    rates = {node: set[int | None]() for node in "arb"}
    for record in on_air:
        header = radiotap.decode(record.frame)
        assert header is not None
        if record.direction is Direction.INBOUND and not header.is_echo:
            heard[record.node].add(header.signal_dbm)
            rates[record.node].add(header.rate_bps)
    assert heard == {"a": {-60.0}, "r": {-60.0, -80.0}, "b": {-80.0}}
    assert max(filter(None, rates["a"])) > max(filter(None, rates["b"])), "each hop at a rate that its signal carries"


def test_a_node_that_hears_and_is_not_heard_is_no_way(make_lab: MakeLab) -> None:
    """The short way's one direction is dead: everything goes around it."""
    nodes: dict[str, Any] = {"a": {}, "b": {}, "r": {}}
    pairs = [{"between": ["a", "r"]}, {"between": ["r", "b"]}, {"from": "a", "to": "b"}]
    radio = {"propagation": {"model": "table", "pairs": pairs}}
    lab = make_lab({**QUIET, "nodes": nodes, "links": [], "radio": radio})
    assert lab.exec("a", "sh", "-c", PATIENT).returncode == 0
    told = json.loads(lab.exec("a", "wnet", "routes", "--json").stdout)["routes"]
    assert {(row["destination"][-2:], row["hops"]) for row in told} == {("02", 2), ("03", 1)}


KEYS = ("11" * 32, "22" * 32)


def test_forged_hellos_from_outside_the_team_are_counted_and_do_nothing(make_lab: MakeLab) -> None:
    pytest.importorskip("cryptography")
    stranger = {"wnet": {"key": KEYS[1]}}
    nodes = {**LINE["nodes"], "m": stranger}
    links = [*LINE["links"], {"between": ["r", "m"]}]
    lab = make_lab({**LINE, "nodes": nodes, "links": links, "wnet": {"key": KEYS[0]}})
    storm = lab.spawn("m", sys.executable, str(PROGRAMS), "forge", "eth0", "2000")
    result = lab.run()
    storm.close()
    assert result.stream("t")["delivered"] == result.stream("t")["sent"] == 40, result.report()
    _, events = recorded(lab)
    told = [event.payload for event in events if event.topic == "/r/wnet/events"]
    assert {row["neighbour"][-2:] for row in told if row["event"] == "link_up"} == {"01", "03"}, "never the stranger"
    refused = {name: value for row in told if row["event"] == "stats" for name, value in row.items()}
    assert sum(refused.get(name, 0) for name in ("unsealed", "forged", "unknown_key")) > 100


def test_a_node_with_another_s_address_is_told_of(make_lab: MakeLab) -> None:
    lab = make_lab(LINE)
    lab.begin()
    same = "ip link set wnet0 down; ip link set wnet0 address 02:4e:4d:00:00:01; ip link set wnet0 up"
    assert lab.exec("b", "sh", "-c", same).returncode == 0
    lab.kill("b", "wnet")
    lab.restart("b", "wnet")
    lab.finish()
    _, events = recorded(lab)
    assert any(event.text("event") == "duplicate_address" for event in events if event.node in "ar")
