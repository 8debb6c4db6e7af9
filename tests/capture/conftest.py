"""A small but complete capture, written by the product's own writer."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from netlab.capture.schemas import Direction, encode_packet, encode_packet_names, encode_verdict, encode_verdict_ends
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.medium.verdicts import Verdict

T0_NS = 1_800_000_000_000_000_000
PORTS = [
    {"node": "base", "interface": "eth0", "address": "10.1.0.1/24", "rate_bps": 10e6},
    {"node": "robot1", "interface": "eth0", "address": "10.1.0.2/24", "rate_bps": None},
]


def udp_frame(payload: bytes, *, source: str = "10.1.0.1", destination: str = "10.1.0.2", port: int = 8700) -> bytes:
    """An Ethernet frame with a UDP datagram; checksums left 0, as nothing here looks at them."""
    ends = b"".join(bytes(map(int, address.split("."))) for address in (source, destination))
    udp = struct.pack("!HHHH", port, port, 8 + len(payload), 0) + payload
    ip = struct.pack("!BBHHHBBH", 0x45, 0, 20 + len(udp), 1, 0, 64, 17, 0) + ends
    return bytes.fromhex("020000000002020000000001") + b"\x08\x00" + ip + udp


def add_packet(topics: Topics, node: str, interface: str, t_ns: int, frame: bytes, direction: Direction) -> None:
    channel, linktype = topics.packets(node, interface, 1)
    names = encode_packet_names(node, interface)
    head = encode_packet(zlib.crc32(frame), len(frame), linktype, direction, names, len(frame))
    topics.writer.add_message(channel, t_ns, t_ns, head, frame)


def add_verdict(topics: Topics, t_ns: int, frame: bytes, verdict: Verdict) -> None:
    ends = encode_verdict_ends(("base", "eth0"), ("robot1", "eth0"))
    departs_ns = t_ns + 20_000_000 if verdict is Verdict.DELIVERED else 0
    body = encode_verdict(ends, verdict, departs_ns, len(frame), zlib.crc32(frame))
    topics.writer.add_message(topics.verdicts(), t_ns, t_ns, body)


def fill(topics: Topics, *, packets: int) -> None:
    """``packets`` datagrams from base to robot1, every third one lost, four to a chunk."""
    topics.add_json("/timeline", {"t_ns": T0_NS, "at_s": 0.0, "kind": "start", "label": "start"}, T0_NS)
    for number in range(packets):
        t_ns = T0_NS + number * 1_000_000
        frame = udp_frame(b"%04d" % number + bytes(range(256)))
        add_packet(topics, "base", "eth0", t_ns, frame, Direction.OUTBOUND)
        lost = number % 3 == 2
        add_verdict(topics, t_ns + 50_000, frame, Verdict.LOST if lost else Verdict.DELIVERED)
        if not lost:
            add_packet(topics, "robot1", "eth0", t_ns + 20_050_000, frame, Direction.INBOUND)
        if number % 4 == 3:
            topics.writer.flush()
    event = {"t_ns": T0_NS + 5_000_000, "event": "peer_up", "peer": "robot1", "reason": "discovered"}
    topics.add_json("/base/udp_mesh/events", event, T0_NS + 5_000_000)


@pytest.fixture
def write_capture(tmp_path: Path) -> Callable[..., Path]:
    """Write a capture of so many packets and return its path."""

    def write(*, packets: int = 12, name: str = "run.mcap") -> Path:
        path = tmp_path / name
        writer = CaptureWriter(path)
        metadata = {"name": "test", "seed": "7", "t0_ns": str(T0_NS), "ports": json.dumps(PORTS), "duration_s": "1.0"}
        writer.add_metadata("netlab.run", metadata)
        writer.add_attachment("scenario.yaml", "text/yaml", b"name: test\n", log_ns=T0_NS)
        fill(Topics(writer), packets=packets)
        writer.close()
        assert writer.error is None
        return path

    return write
