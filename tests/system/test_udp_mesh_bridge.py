"""A bridge between real carriers: in a lab between two wires, and between a network and a slow serial line."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import time
import tty
from pathlib import Path

import pytest

from netlab.pytest_plugin import MakeLab
from tests.system.udp_mesh_hosts import Line, join, separate_hosts
from udp_mesh.client import Client

LINE = {
    "duration": "6s",
    "nodes": {
        "rover": {"processes": ["udp_mesh"]},
        "relay": {"processes": ["udp_mesh"], "udp_mesh": {"bridge": True}},
        "base": {"processes": ["udp_mesh"]},
    },
    "links": [
        {"between": ["rover", "relay"], "delay": "2ms"},
        {"between": ["relay", "base"], "delay": "3ms", "loss": "2%"},
    ],
    "traffic": [
        {"from": "rover", "to": "base", "topic": "telemetry", "size": "100B", "rate": "20Hz", "priority": 1},
        {"from": "rover", "to": "base", "topic": "map", "size": "50kB", "rate": "2Hz", "priority": 7},
        {"from": "base", "to": "all", "topic": "orders", "size": "80B", "rate": "5Hz", "priority": 0},
    ],
    "events": [{"at": "2s", "kill": {"node": "relay", "process": "udp_mesh"}, "restart": "300ms"}],
}


def test_streams_cross_a_bridge_and_outlive_its_restart(make_lab: MakeLab) -> None:
    result = make_lab(LINE).run()
    for topic in ("telemetry", "map"):
        stream = result.stream(topic)
        assert stream["delivered"] == stream["sent"], result.report()
        assert stream["duplicates"] == 0
    assert 0.005 <= result.stream("telemetry")["latency_s"]["p50"] < 0.02
    for stream in result.summary["streams"]:
        assert stream["delivered"] >= stream["sent"] * 0.75, result.report()  # one datagram for all is sent once


KEY = "00" * 31 + "01"


@pytest.mark.parametrize("key", ["", f'key = "{KEY}"\n'], ids=["plain", "sealed"])
def test_a_node_on_a_serial_line_of_5_kbit_per_second_reaches_one_two_carriers_away(tmp_path: Path, key: str) -> None:
    with contextlib.ExitStack() as stack:
        rover, relay, sensor = stack.enter_context(separate_hosts(tmp_path, "rover", "relay", "sensor"))
        join(rover, relay, "mesh0", network="10.9.0")
        ends = [_terminal(stack) for _ in range(2)]
        line = Line(ends[0][0], ends[1][0], rate_bps=5000)
        line.start()
        stack.callback(line.end)
        serial = [f'[[carriers]]\nkind = "serial"\ndevice = "{d}"\nmtu_bytes = 255\nrate_bps = 5000\n' for _, d in ends]
        rover.start(key)
        relay.start(f'bridge = true\n{key}{serial[0]}[[carriers]]\nkind = "udp"\n')
        sensor.start(key + serial[1])
        here = stack.enter_context(Client(rover.socket))
        there = stack.enter_context(Client(sensor.socket))
        for client in (here, there):
            client.subscribe("report")
            client.subscribe("telemetry")
            client.stats()
        assert here.wait_for_peer("sensor", 20.0)
        assert there.wait_for_peer("rover", 20.0)
        for source, destination, name in ((here, there, "sensor"), (there, here, "rover")):
            source.publish_wait("report", bytes(2000), to=name, priority=9)
            urgent_at_s = time.monotonic()
            source.publish_wait("telemetry", b"urgent", to=name, priority=1)
            first, second = destination.receive(timeout_s=30.0), destination.receive(timeout_s=30.0)
            assert first is not None
            assert second is not None
            assert (first.topic, second.topic, len(second.payload)) == ("telemetry", "report", 2000)
            assert first.received_ns / 1e9 - time.time() + time.monotonic() - urgent_at_s < 2.5
            assert second.received_ns - first.received_ns > 1.5e9, "the report takes three seconds"
        assert not rover.happened("peer_down")
        assert not sensor.happened("peer_down")
        (peer,) = [peer for peer in here.peers() if peer.name == "sensor"]
        assert peer.address == "10.9.0.2"
        words = [sys.executable, "-m", "udp_mesh", "--socket", rover.socket, "peers"]
        table = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert re.search(r"in use +10\.9\.0\.2 \(bridge relay\), heard \d+\.\d s ago, 0% lost, 5 kbit/s", table), table


def _terminal(stack: contextlib.ExitStack) -> tuple[int, str]:
    """Return one end of a pseudo-terminal and the name of the other."""
    pair = os.openpty()
    tty.setraw(pair[1])
    for descriptor in pair:
        stack.callback(os.close, descriptor)
    return pair[0], os.ttyname(pair[1])
