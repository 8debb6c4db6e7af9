"""Fixed neighbours end to end: the capture holds no broadcast, and messages arrive."""

from __future__ import annotations

from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord
from netlab.pytest_plugin import MakeLab

TEAM = {
    "duration": "4s",
    "nodes": {name: {"processes": ["udp_mesh"]} for name in ("base", "robot1", "robot2")},
    "radio": {"delay": "2ms", "propagation": {"model": "none"}},
    "udp_mesh": {"neighbours": ["base", "robot1", "robot2"]},
    "traffic": [
        {"from": "robot1", "to": "base", "topic": "telemetry", "size": "100B", "rate": "10Hz", "priority": 1},
        {"from": "base", "to": "all", "topic": "orders", "size": "50B", "rate": "5Hz"},
    ],
}
IPV4, UDP = bytes.fromhex("0800"), 17


def test_no_frame_of_the_team_is_a_broadcast(make_lab: MakeLab) -> None:
    lab = make_lab(TEAM)
    result = lab.run()
    for stream in result.summary["streams"]:
        assert stream["delivered"] == stream["sent"] > 0, result.report()
    with Capture.open(lab.capture) as capture:
        frames = [record.frame for record in capture.records({Kind.PACKET}) if isinstance(record, PacketRecord)]
    datagrams = [frame for frame in frames if frame[12:14] == IPV4 and frame[23] == UDP]
    assert len(datagrams) > 100
    assert not [frame for frame in datagrams if frame[0] & 1], "every datagram has one addressee"
