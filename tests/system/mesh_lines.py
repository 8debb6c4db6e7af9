"""Scenarios that the tests of several meshes have in common, and what they all ask of a capture."""

from __future__ import annotations

from typing import Any

from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind, PacketRecord
from netlab.lab.facade import Lab

TALKER = {"processes": ["udp_mesh"]}


def line(mesh: str) -> dict[str, Any]:
    """a - r - b by wires of 2 ms, with 40 messages from a to b."""
    return {
        "duration": "2s",
        "mesh": mesh,
        "nodes": {"a": TALKER, "r": {}, "b": TALKER},
        "links": [{"between": ["a", "r"], "delay": "2ms"}, {"between": ["r", "b"], "delay": "2ms"}],
        "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "20Hz"}],
    }


def line_with_a_killed_relay(mesh: str) -> dict[str, Any]:
    """The line for 3 s, whose relay's process is killed at 0.5 s and comes back half a second later."""
    of_line = line(mesh)
    kill = {"at": "0.5s", "kill": {"node": "r", "process": mesh}, "restart": "500ms"}
    return {
        **of_line,
        "duration": "3s",
        "events": [kill],
        "traffic": [{**of_line["traffic"][0], "offline": "store"}],
    }


def recorded(lab: Lab) -> tuple[list[PacketRecord], list[JsonRecord]]:
    """The packets and the events of a lab's capture."""
    with Capture.open(lab.capture) as capture:
        packets = [record for record in capture.records({Kind.PACKET}) if isinstance(record, PacketRecord)]
        events = [record for record in capture.records({Kind.EVENT}) if isinstance(record, JsonRecord)]
    return packets, events


def check_wrapping(packets: list[PacketRecord], interface: str, ethertype: bytes) -> None:
    """In the line, members carry nothing but the mesh, and its interface nothing of it."""
    kinds = {(record.node, record.interface): set[bool]() for record in packets}
    for record in packets:
        kinds[record.node, record.interface].add(record.frame[12:14] == ethertype)
    assert kinds["a", interface] == {False}, "inside the mesh interface frames are plain"
    for member in (("a", "eth0"), ("r", "eth0"), ("r", "eth1"), ("b", "eth0")):
        assert kinds[member] == {True}, "members carry nothing but the mesh"


def end_process(lab: Lab, node: str, process: str) -> None:
    """Kill a process from inside its node, as an accident would, half a second into the run."""
    lab.begin()
    lab.wait_until(0.5)
    [pid] = [row["pid"] for row in lab.status()["processes"] if (row["node"], row["process"]) == (node, process)]
    assert lab.exec(node, "kill", "-9", str(pid)).returncode == 0
