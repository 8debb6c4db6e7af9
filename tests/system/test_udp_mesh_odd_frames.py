"""Odd frames on a real network, at a real daemon: it names each in its counters and goes on as before."""

from __future__ import annotations

import json
import sys
from collections import Counter
from typing import Any

from netlab.lab.facade import Lab
from netlab.pytest_plugin import MakeLab
from netlab.scapy_layers.udp_mesh import Hello, Probe, UdpMesh
from tests.scapy_layers.odd_frames import ODD, odd_datagram

SCENARIO = {
    "name": "odd",
    "duration": "1s",
    "nodes": {"base": {"processes": ["udp_mesh"]}, "odd": {}},
    "links": [{"between": ["base", "odd"], "delay": "1ms"}],
}
EPOCH, TAG = 0x99_0000_0123, 0x123
#: Sends each line of its input; after the first and after the last it waits until it is answered.
SENDER = f"""
import socket, sys
mesh = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
mesh.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
mesh.bind(("0.0.0.0", 8700))
mesh.settimeout(10)
first, *odd, last = map(bytes.fromhex, sys.stdin.read().split())
def ask(datagram):
    mesh.sendto(datagram, ("base", 8700))
    while {TAG.to_bytes(4, "big")!r} not in mesh.recv(2000)[12:]:
        pass
ask(first)
for datagram in odd:
    mesh.sendto(datagram, ("base", 8700))
ask(last)
"""


def stats(lab: Lab) -> dict[str, Any]:
    done = lab.exec("base", sys.executable, "-m", "udp_mesh", "stats")
    told: dict[str, Any] = json.loads(done.stdout)
    return told


def introduction(number: int) -> bytes:
    """A beacon that asks everybody to answer."""
    frames = [Hello(node=b"odd"), Probe(wanted=[0])]
    return bytes(UdpMesh(flags="unnumbered", epoch=EPOCH, packet_number=number, frames=frames))


def test_a_daemon_names_odd_frames_and_goes_on(make_lab: MakeLab) -> None:
    lab = make_lab(SCENARIO)
    before = stats(lab)
    odd = [odd_datagram(name, epoch=EPOCH, tag=TAG, number=1000 + at) for at, name in enumerate(ODD)]
    lines = [introduction(1), *(data for data, _reason in odd), introduction(2)]
    done = lab.exec("odd", sys.executable, "-c", SENDER, text="\n".join(line.hex() for line in lines))
    assert (done.returncode, done.stderr) == (0, "")
    after = stats(lab)
    counted = {key: value for key, value in after["counters"].items() if key.startswith("bad_")}
    assert not [key for key in before["counters"] if key.startswith("bad_")]
    assert counted == Counter(f"bad_{reason}" for _data, reason in odd)
    assert [peer["name"] for peer in after["peers"]] == ["odd"]
    assert after["queues"] == before["queues"]
