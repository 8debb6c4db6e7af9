"""Nodes in a flood: over hops by wire and radio, on every engine and clock, and what its death does."""

from __future__ import annotations

import json
import re

import pytest

from netlab.pytest_plugin import MakeLab
from tests.system.mesh_lines import check_wrapping, end_process, line, line_with_a_killed_relay, recorded

pytestmark = pytest.mark.usefixtures("taps")

FLOOD_TYPE = bytes.fromhex("88b5")
LINE = line("flood")
IN_RANGE = [{"between": ["a", "r"], "delay": "1ms"}, {"between": ["r", "b"], "delay": "1ms"}]
BY_RADIO = {**LINE, "links": [], "radio": {"propagation": {"model": "table", "pairs": IN_RANGE}}}


def test_messages_cross_a_relay_and_the_capture_tells_all(make_lab: MakeLab) -> None:
    lab = make_lab(LINE)
    result = lab.run()
    stream = result.stream("t")
    assert stream["delivered"] == stream["sent"] == 40, result.report()
    assert stream["duplicates"] == 0
    assert stream["latency_s"]["p50"] >= 0.004  # both hops
    packets, events = recorded(lab)
    check_wrapping(packets, "flood0", FLOOD_TYPE)
    assert {name for pair in result.trace.links for _, name in pair} == {"eth0", "eth1"}
    relayed = [event.payload["relayed"] for event in events if event.node == "r" and event.text("event") == "stats"]
    assert relayed, "the relay tells what it has counted"
    assert relayed == sorted(relayed)


def test_by_radio_a_relay_sends_again_where_it_heard(make_lab: MakeLab) -> None:
    lab = make_lab(BY_RADIO)
    result = lab.run()
    assert result.stream("t")["delivered"] == result.stream("t")["sent"] == 40, result.report()
    assert {name for pair in result.trace.links for _, name in pair} == {"radio0"}


def test_pings_broadcasts_and_whole_packets_pass(make_lab: MakeLab) -> None:
    lab = make_lab(LINE)
    told = json.loads(lab.exec("r", "ip", "-json", "address").stdout)
    found = {link["ifname"]: [entry["family"] for entry in link["addr_info"]] for link in told}
    assert found.pop("flood0") == ["inet", "inet6"]
    assert found.pop("lo")
    assert found == {"eth0": [], "eth1": []}
    mtu = {link["ifname"]: link["mtu"] for link in told}
    assert (mtu["flood0"], mtu["eth0"]) == (1500, 1532)
    assert lab.exec("a", "getent", "hosts", "b").stdout.split()[0] == "10.240.0.3"
    whole = lab.exec("a", "ping", "-c3", "-i0.2", "-Mdo", "-s1472", "b")
    assert whole.returncode == 0, whole.stdout
    everybody = lab.exec("a", "ping", "-b", "-c1", "-W2", "10.240.255.255")
    assert "0 received" in everybody.stdout or everybody.returncode == 0  # answered only where the kernel is told to
    neighbours = json.loads(lab.exec("b", "ip", "-json", "neighbour").stdout)
    assert {entry["dst"]: entry["dev"] for entry in neighbours if entry["dst"].startswith("10.")} == {
        "10.240.0.1": "flood0"
    }


@pytest.mark.parametrize("how", ["interface", "cable"])
def test_a_member_that_went_down_and_came_back_carries_again(make_lab: MakeLab, how: str) -> None:
    lab = make_lab(LINE)
    ping = "for try in $(seq 20); do ping -c1 -W1 b && exit; done; exit 1"

    def switch(up: bool) -> None:
        if how == "cable":
            lab.carrier("r", "b", up=up)
        else:
            assert lab.exec("r", "ip", "link", "set", "eth1", "up" if up else "down").returncode == 0

    assert lab.exec("a", "sh", "-c", ping).returncode == 0
    switch(False)
    assert lab.exec("a", "ping", "-c1", "-W1", "b").returncode == 1
    switch(True)
    assert lab.exec("a", "sh", "-c", ping, timeout_s=60).returncode == 0, lab.log("r", "flood")
    assert {row["state"] for row in lab.status()["processes"]} == {"ready"}


def test_the_end_of_a_flood_is_reported(make_lab: MakeLab) -> None:
    lab = make_lab(LINE)
    end_process(lab, "r", "flood")
    result = lab.finish()
    assert any(
        re.match(r"r: process 'flood' was ended by SIGKILL; argv: netlab-flood", text) for text in result.problems
    )
    assert result.stream("t")["delivered"] < 40


def test_a_flood_that_was_killed_works_again_after_its_restart(make_lab: MakeLab) -> None:
    result = make_lab(line_with_a_killed_relay("flood")).run()
    assert not result.problems, result.report()
    assert result.stream("t")["delivered"] == 60, result.report()
    assert result.stream("t")["longest_gap_s"] >= 0.3, "it was away"
