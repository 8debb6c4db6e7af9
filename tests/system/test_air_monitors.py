"""The radios in monitor mode that the air engine plays: what goes in at one comes out at the others, and is told of."""

from __future__ import annotations

import json
import sys
import threading
from typing import Any

import pytest

from netlab.lab.facade import Lab
from netlab.pytest_plugin import MakeLab

pytestmark = pytest.mark.usefixtures("taps")

PROGRAM = """
import json, select, socket, sys, time
from wnet.io import dot11, radiotap
sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
sock.bind(("radio0", 3))
heard, end = [], time.monotonic() + float(sys.argv[1])
time.sleep(0.5 if sys.argv[2:] else 0)
if sys.argv[2:]:
    frame = bytes.fromhex("ffffffffffff02aaaaaaaaaa88b7") + b"x" * 400
    for rate in map(int, sys.argv[2:]):
        sock.send(radiotap.encode_transmit(rate or None) + dot11.encode(frame))
    sock.send(b"neither radiotap nor 802.11")
while (left := end - time.monotonic()) > 0:
    if select.select([sock], [], [], left)[0]:
        data, (_, _, kind, hatype, *_) = sock.recvfrom(4096)
        header = radiotap.decode(data)
        inner = header and dot11.decode(data, header.length_bytes)
        if inner and inner[12:14] == bytes.fromhex("88b7") and kind != 4:
            figures = [header.signal_dbm, header.noise_dbm, header.rate_bps, header.is_echo, hatype]
            heard.append(figures)
print(json.dumps(heard))
"""
RADIOS: dict[str, Any] = {
    "duration": "1s",
    "mesh": "wnet",
    "nodes": {"a": {}, "b": {}, "c": {}},
    "radio": {
        "phy": "802.11g-20MHz",
        "propagation": {
            "model": "table",
            "pairs": [{"between": ["a", "b"], "rssi": "-55dBm"}, {"between": ["a", "c"], "rssi": "-83dBm"}],
        },
    },
}


def test_signal_noise_and_rate_arrive_and_a_rate_that_is_too_fast_does_not(make_lab: MakeLab) -> None:
    lab = make_lab(RADIOS, packets=False)
    told: dict[str, list[list[object]]] = {}
    listeners = [listening(lab, name, told) for name in "bc"]
    sender = lab.exec("a", sys.executable, "-c", PROGRAM, "2", "6000000", "54000000", "0")
    for listener in listeners:
        listener.join()
    echoes = json.loads(sender.stdout)
    assert [row[2:] for row in echoes] == [[6e6, True, 803], [54e6, True, 803], [6e6, True, 803]], "each is reported"
    assert told["b"] == [[-55, -91, rate, False, 803] for rate in (6e6, 54e6, 6e6)]
    assert told["c"] == [[-83, -91, 6e6, False, 803]] * 2, "8 dB do not carry 54 Mbit/s"


FILTERED = """
import json, select, sys, time
from wnet.io.members import open_port
port = open_port("radio0", mac=bytes.fromhex(sys.argv[1]))
got, end = 0, time.monotonic() + 2.5
raw = port.__dict__["_socket"]
while (left := end - time.monotonic()) > 0:
    if select.select([port], [], [], left)[0]:
        while (data := raw.receive()) is not None:
            got += data[-4:] == b"mark"
print(got)
"""
MARK = """
import socket, time
from wnet.io import dot11, radiotap
time.sleep(0.7)
sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
sock.bind(("radio0", 0))
ends = ("024e4c000001", "024e4c000009"), ("0357ffffffff", "024e4c000009"), ("024e4c000007", "024e4c000001")
for to, by in (*ends, ("024e4c000007", "024e4c000009")):
    sock.send(radiotap.encode_transmit(None) + dot11.encode(bytes.fromhex(to + by + "88b7") + b"mark"))
"""


def test_a_member_is_not_woken_up_by_frames_for_others(make_lab: MakeLab) -> None:
    lab = make_lab(RADIOS, packets=False)
    told: dict[str, str] = {}
    argv = (sys.executable, "-c", FILTERED, "024e4c000001")
    listener = threading.Thread(target=lambda: told.update(b=lab.exec("b", *argv).stdout))
    listener.start()
    assert lab.exec("a", sys.executable, "-c", MARK).returncode == 0
    listener.join()
    assert told["b"] == "3\n", "to it, to a group, and from it as a report; not between two others"


def listening(lab: Lab, name: str, told: dict[str, list[list[object]]]) -> threading.Thread:
    """Note what a node hears meanwhile."""

    def run() -> None:
        told[name] = json.loads(lab.exec(name, sys.executable, "-c", PROGRAM, "2.5").stdout)

    thread = threading.Thread(target=run)
    thread.start()
    return thread
