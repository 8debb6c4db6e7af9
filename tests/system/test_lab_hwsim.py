"""Radios that are real 802.11 interfaces, on a kernel that has mac80211_hwsim: run these in the box, in virtual time.

netlab vm --clock virtual -- python -m pytest tests/system/test_lab_hwsim.py
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from scapy.layers.dot11 import RadioTap

from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord, VerdictRecord
from netlab.errors import LabError
from netlab.kernel import hwsim
from netlab.kernel.nl80211 import Nl80211
from netlab.lab.facade import Lab
from netlab.medium.verdicts import Verdict
from netlab.pytest_plugin import MakeLab

TOPOLOGIES = Path(__file__).parents[2] / "topologies"
MISSING = hwsim.missing()
radios = pytest.mark.skipif(
    MISSING is not None,
    reason=f"{MISSING}; run it in the box: netlab vm --clock virtual -- python -m pytest {__file__}",
)

STATIONS = """
import json, socket
from netlab.kernel.nl80211 import Nl80211
rows = {}
for station in Nl80211().stations(socket.if_nametoindex("radio0")):
    counts = [station.tx_packets, station.tx_retries, station.tx_failed]
    rows[station.mac.hex(":")] = [station.signal_dbm, station.established, *counts]
print(json.dumps(rows))
"""
RECEIVE = """
import os, socket, sys
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
sock.bind(("", 9))
os.write(int(os.environ["READY_FD"]), b"1")
sock.settimeout(3)
got = 0
try:
    while True:
        got += sock.recv(100) != b"warm up"
except TimeoutError:
    print(got)
"""
SEND = """
import socket, sys, time
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for number in range(int(sys.argv[2])):
    sock.sendto(b"%06d" % number, (sys.argv[1], 9))
    time.sleep(0.001)
"""


def wifi(pairs: list[dict[str, Any]], **keys: Any) -> dict[str, Any]:
    radio = {"driver": "hwsim", "propagation": {"model": "table", "pairs": pairs}, **keys}
    return {"name": "wifi", "duration": "5s", "radio": radio, "nodes": {"a": {}, "b": {}, "c": {}}}


CHAIN = [{"between": ["a", "b"], "rssi": "-62dBm"}, {"between": ["b", "c"], "rssi": "-71dBm"}]


def ping(lab: Lab, sender: str, receiver: str, count: int = 5) -> str:
    done = lab.exec(sender, "ping", "-c", str(count), "-i", "0.2", "-W", "1", receiver)
    assert done.stdout, done.stderr
    return done.stdout


def stations(lab: Lab, node: str) -> dict[str, list[Any]]:
    """Signal, established, packets, retries and failures of each neighbour, by the neighbour's name."""
    names = {"02:4e:4c:00:00:00": "a", "02:4e:4c:00:00:01": "b", "02:4e:4c:00:00:02": "c"}
    done = lab.exec(node, sys.executable, "-c", STATIONS)
    return {names[mac]: values for mac, values in json.loads(done.stdout).items()}


@radios
def test_the_mesh_forwards_over_the_middle_to_a_node_out_of_range(make_lab: MakeLab) -> None:
    lab = make_lab(wifi(CHAIN))
    assert " 0% packet loss" in ping(lab, "a", "c")
    assert {node: set(stations(lab, node)) for node in "abc"} == {"a": {"b"}, "b": {"a", "c"}, "c": {"b"}}
    lab.outage("b", "c", active=True)
    assert " 100% packet loss" in ping(lab, "a", "c")
    assert " 0% packet loss" in ping(lab, "a", "b")
    lab.outage("b", "c", active=False)
    ping(lab, "a", "c", 15)  # path selection notices in its own time
    assert " 0% packet loss" in ping(lab, "a", "c")


@radios
def test_in_an_ad_hoc_network_only_neighbours_talk(make_lab: MakeLab) -> None:
    lab = make_lab(wifi(CHAIN, mode="ibss", frequency="5180MHz"))
    assert " 0% packet loss" in ping(lab, "a", "b")
    assert " 0% packet loss" in ping(lab, "c", "b")
    assert " 100% packet loss" in ping(lab, "a", "c")


@radios
def test_a_receiver_sees_the_strength_that_is_set_and_that_a_change_sets(make_lab: MakeLab) -> None:
    lab = make_lab(wifi([*CHAIN, {"from": "a", "to": "c", "rssi": "-80dBm"}]))
    ping(lab, "a", "b")
    ping(lab, "c", "b")
    assert {name: values[0] for name, values in stations(lab, "b").items()} == {"a": -62, "c": -71}
    lab.link("a", "b", one_way=True, rssi="-83dBm")
    ping(lab, "a", "b")
    assert {name: values[0] for name, values in stations(lab, "b").items()} == {"a": -83, "c": -71}
    assert stations(lab, "a")["b"][0] == -62


@radios
def test_loss_is_per_attempt_and_the_kernel_counts_the_same_retries(make_lab: MakeLab) -> None:
    loss, tries, count = 0.4, 2, 3000
    pairs = [{"from": "a", "to": "b", "loss": "40%"}, {"from": "b", "to": "a"}]
    scenario = wifi(pairs, mode="ibss", retry_limit=tries)
    scenario["nodes"]["b"] = {"processes": [{"argv": [sys.executable, "-uc", RECEIVE], "name": "sink", "ready": "fd"}]}
    lab = make_lab(scenario)
    while " 0 received" in ping(lab, "a", "b", 1):  # until the neighbour is resolved
        pass
    before = stations(lab, "a")["b"]
    lab.exec("a", sys.executable, "-c", SEND, "b", str(count))
    after = stations(lab, "a")["b"]
    lab.exec("b", "sleep", "4")
    received = int(lab.log("b", "sink").split()[-1])
    arrives = 1 - loss**tries
    # 99.99 %: an interval of 99 % would fail one run in a hundred without a fault.
    within = 3.9 * math.sqrt(arrives * (1 - arrives) * count)
    assert abs(received - arrives * count) < within
    retries, failed = after[3] - before[3], after[4] - before[4]
    assert abs(retries - loss * count) < 3.9 * math.sqrt(loss * (1 - loss) * count) + 5  # and those of neighbour probes
    assert abs(failed - (count - received)) <= 5


@radios
def test_a_monitor_captures_frames_with_radiotap(make_lab: MakeLab) -> None:
    lab = make_lab(wifi(CHAIN, monitor=True) | {"duration": "1s"})
    lab.begin()
    ping(lab, "a", "b", 3)
    lab.finish()
    with Capture.open(lab.capture) as capture:
        links = {t.name: t.metadata["linktype"] for t in capture.topics if t.name.endswith("/packets")}
        frames = [r for r in capture.records({Kind.PACKET}) if isinstance(r, PacketRecord) and r.interface == "mon0"]
    assert links["/b/mon0/packets"] == "127"
    assert links["/b/radio0/packets"] == "1"
    strengths = Counter()
    for record in frames:
        seen = RadioTap(record.frame)
        if record.node == "b" and seen.dBm_AntSignal is not None:
            strengths[seen.addr2, seen.dBm_AntSignal] += 1
    assert set(strengths) == {("02:4e:4c:00:00:00", -62), ("02:4e:4c:00:00:02", -71)}
    assert {record.node for record in frames} == {"a", "b", "c"}


@radios
def test_daemons_talk_over_two_hops_and_the_capture_tells_every_decision(make_lab: MakeLab) -> None:
    lab = make_lab(TOPOLOGIES / "wifi_two_hops.yaml")
    result = lab.run()
    assert result.passed, result.report()
    with Capture.open(lab.capture) as capture:
        verdicts = [r for r in capture.records({Kind.VERDICT}) if isinstance(r, VerdictRecord)]
    strengths = {(r.sender[0], r.receiver[0]): r.rssi_dbm for r in verdicts}
    assert strengths["base", "relay"] == -62
    assert strengths["robot1", "relay"] == -71
    attempts = Counter(r.attempts for r in verdicts)
    assert set(attempts) <= set(range(1, 8))
    assert attempts[1] > attempts[2] > 0
    delivered = Counter((r.sender[0], r.receiver[0]) for r in verdicts if r.verdict is Verdict.DELIVERED)
    assert set(delivered) == {("base", "relay"), ("relay", "base"), ("relay", "robot1"), ("robot1", "relay")}
    assert {row["from"] for row in result.summary["links"]} >= {"base/radio0", "relay/radio0"} or result.summary[
        "links"
    ]


@radios
def test_events_cut_flap_and_change_radios(make_lab: MakeLab) -> None:
    mesh = {"processes": ["udp_mesh"]}
    lab = make_lab(
        {
            "name": "cut",
            "duration": "12s",
            "radio": {"driver": "hwsim", "mode": "ibss", "propagation": {"model": "none"}},
            "nodes": {"a": mesh, "b": mesh},
            "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "20Hz", "offline": "latest"}],
            "events": [
                {"at": "2s", "outage": {"between": ["a", "b"], "for": "2s"}},
                {"at": "6s", "flap": {"between": ["a", "b"], "up": "1s", "down": "500ms", "until": "9s"}},
                {"at": "10s", "link": {"between": ["a", "b"], "loss": "30%", "rssi": "-85dBm"}},
            ],
            "expect": [{"reconnect": {"between": ["a", "b"]}, "max": "300ms"}],
        }
    )
    result = lab.run()
    assert result.passed, result.report()
    assert len(result.summary["reconnects"]) == 3
    with Capture.open(lab.capture) as capture:
        verdicts = [r for r in capture.records({Kind.VERDICT}) if isinstance(r, VerdictRecord)]
        t0_ns = result.trace.t0_ns
    cut = [(r.t_ns - t0_ns) / 1e9 for r in verdicts if r.verdict is Verdict.OUTAGE]
    assert cut
    for at_s in cut:
        assert 2 <= at_s < 4.01 or 6 <= at_s < 6.51 or 7.5 <= at_s < 8.01, at_s
    assert stations(lab, "b")["a"][0] == -85


@radios
@pytest.mark.parametrize("engine", ["air", "netem"])
def test_wires_beside_radios_keep_their_engine(make_lab: MakeLab, engine: str) -> None:
    scenario = wifi([{"between": ["a", "b"], "delay": "4ms"}])
    scenario |= {"links": [{"between": ["b", "c"], "delay": "7ms"}], "duration": "2s"}
    lab = make_lab(scenario, engine=engine)
    lab.begin()
    assert round_trip_ms(ping(lab, "b", "c-eth0")) == pytest.approx(14, abs=0.5)
    assert round_trip_ms(ping(lab, "a", "b-radio0")) == pytest.approx(8, abs=0.5)
    lab.carrier("b", "c", up=False)
    assert " 100% packet loss" in ping(lab, "b", "c-eth0", 1)
    with pytest.raises(LabError, match="rssi belongs to 802"):
        lab.link("b", "c", rssi="-50dBm")
    with pytest.raises(LabError, match="cannot duplicate"):
        lab.link("a", "b", duplicate="5%")
    lab.finish()
    with Capture.open(lab.capture) as capture:
        verdicts = [r for r in capture.records({Kind.VERDICT}) if isinstance(r, VerdictRecord)]
    senders = {r.sender for r in verdicts}
    assert ("a", "radio0") in senders
    assert (("b", "eth0") in senders) is (engine == "air")


def round_trip_ms(said: str) -> float:
    return float(said.rsplit("= ", 1)[1].split("/")[0])  # the least


@radios
def test_two_labs_with_the_same_addresses_do_not_hear_each_other(make_lab: MakeLab) -> None:
    first, second = make_lab(wifi(CHAIN)), make_lab(wifi([{"between": ["a", "c"]}]))
    assert " 0% packet loss" in ping(first, "a", "c")
    assert " 0% packet loss" in ping(second, "a", "c")
    assert " 100% packet loss" in ping(second, "a", "b")
    assert set(stations(second, "a")) == {"c"}


@radios
def test_radios_go_with_their_lab(make_lab: MakeLab) -> None:
    with contextlib.closing(Nl80211()) as here:
        before = here.wiphys()
        lab = make_lab(wifi(CHAIN))
        lab.close()
        assert here.wiphys() == before


@radios
def test_a_process_of_the_radios_that_is_killed_ends_the_run(netlab: Any) -> None:
    run = netlab.start("run", TOPOLOGIES / "wifi_two_hops.yaml", "--set", "duration=60s")
    while "running" not in (line := run.stderr.readline()):
        assert line
    os.kill(netlab.process("netlab.engines.hwsim_process"), signal.SIGKILL)
    out, err = run.communicate(timeout=30)
    assert run.returncode == 2
    assert "the hwsim process ended; the radios are gone" in out.partition("THE LAB BROKE: ")[2]
    assert "Traceback" not in out + err


@pytest.mark.skipif(MISSING is None, reason="this kernel has mac80211_hwsim")
def test_without_hwsim_the_lab_names_the_way_out(make_lab: MakeLab) -> None:
    with pytest.raises(Exception, match=r"this kernel has no mac80211_hwsim; .*--in vm"):
        make_lab(wifi(CHAIN))
