"""A capture with something of everything, made of real bytes: a robot drives off, an outage comes and goes."""

from __future__ import annotations

import json
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from netlab.capture.scene import Passage, Pose, map_message, poses_message
from netlab.capture.schemas import (
    Direction,
    encode_attempts,
    encode_packet,
    encode_packet_names,
    encode_verdict,
    encode_verdict_ends,
)
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.medium.verdicts import Verdict
from udp_mesh.core.wire import encode_ack, encode_data_header, encode_header, tag_of

T0_NS = 1_800_000_000_000_000_000
EPOCHS = {"robot1": 0x1111_0000_0000_0001, "base": 0x2222_0000_0000_0002}
ADDRESSES = {"robot1": b"\x0a\0\0\1", "base": b"\x0a\0\0\2"}
MACS = {"robot1": b"\2\0\0\0\0\1", "base": b"\2\0\0\0\0\2"}
DELAY_S = 0.005
OUTAGE_S = (6.0, 9.0)
SCENARIO = """
name: mission
expect:
  - {latency: {topic: telemetry}, p50: 100ms, max: 200ms}
  - {reconnect: {between: [base, robot1]}, max: 300ms}
  - {delivered: {topic: image}, min: 10%}
  - {goodput: {topic: image}, min: 1kbit}
"""


def ns(at_s: float) -> int:
    return T0_NS + round(at_s * 1e9)


class Mission:
    """Writes a capture as the recorder would."""

    def __init__(self, path: Path, *, loss_ratio: float, seed: int) -> None:
        self._writer = CaptureWriter(path)
        self.topics = Topics(self._writer)
        self._rng = random.Random(seed)
        self._loss_ratio = loss_ratio
        self._numbers = {"robot1": 0, "base": 0}
        self._message_id = 0
        streams = [
            {"stream": 0, "source": "robot1", "destination": "base", "topic": "telemetry", "priority": 1},
            {"stream": 1, "source": "robot1", "destination": "base", "topic": "image", "priority": 5},
        ]
        ports = [{"node": node, "interface": "radio0", "mac": MACS[node].hex(":")} for node in MACS]
        told = {"name": "mission", "seed": str(seed), "engine": "air", "clock": "virtual", "duration_s": "12.0"}
        told |= {"t0_ns": str(T0_NS), "streams": json.dumps(streams), "ports": json.dumps(ports), "scenario": SCENARIO}
        self._writer.add_metadata("netlab.run", told)

    def run(self) -> None:
        self.topics.t0_ns = T0_NS
        tunnels = [
            Passage("adit", ((0, 0, 0), (30, 0, 0)), 4.0, 4.0),
            Passage("drift", ((30, 0, 0), (30, 20, 0)), 3, 3),
        ]
        self.topics.add_json("/map", map_message(tunnels), T0_NS)
        self._act(0.0, "start", "t = 0")
        self._links(0.0, "up")
        for tenth in range(120):
            at_s = tenth / 10
            x, y = (2.5 * at_s, 0.0) if at_s <= 12 else (30.0, 0.0)
            poses = [Pose("base", (0, 0, 0), 0.0, True), Pose("robot1", (x, y, 0.0), 0.0, True)]
            self.topics.add_json("/poses", poses_message(poses, at_s), ns(at_s))
            if at_s == OUTAGE_S[0]:
                self._act(at_s, "outage", "outage base-robot1 begins")
                self._links(at_s, "outage")
            if at_s == OUTAGE_S[1]:
                self._act(at_s, "outage_end", "outage base-robot1 ends", restores=["base", "robot1"])
                self._links(at_s, "up")
            self._message(0, tenth, at_s + 0.001, fragments=1, priority=1)
            if tenth % 10 == 0:
                self._message(1, tenth // 10, at_s + 0.02, fragments=6, priority=5)
            if at_s == OUTAGE_S[1]:
                self._exchange(at_s + 0.03)
        self._act(12.0, "end", "the scenario's duration is over")
        self._writer.close()

    def _act(self, at_s: float, kind: str, label: str, **more: object) -> None:
        self.topics.add_json("/timeline", {"kind": kind, "label": label, "at_s": at_s, **more}, ns(at_s))

    def _links(self, at_s: float, state: str) -> None:
        for sender, receiver in (("base", "robot1"), ("robot1", "base")):
            row = {"segment": "radio", "from": sender, "to": receiver, "state": state, "impairment": None}
            self.topics.add_json("/links", row, ns(at_s))

    def _message(self, stream: int, seq: int, at_s: float, *, fragments: int, priority: int) -> None:
        size = 1000 * fragments
        told = {"event": "published", "stream": stream, "publication": stream, "seq": seq, "size_bytes": size}
        self.topics.add_json("/robot1/traffic/published", {**told, "t_ns": ns(at_s)}, ns(at_s))
        self._message_id += 1
        arrivals = []
        for index in range(fragments):
            sent_s = at_s + 0.0005 + 0.001 * index
            while (arrived := self._fragment(stream, seq, index, fragments, priority, at_s, sent_s)) is None:
                sent_s += 0.06
                if sent_s > at_s + 0.5:
                    return
            arrivals.append(arrived)
        received = {**told, "event": "received", "published_ns": ns(at_s)}
        arrived_s = max(arrivals) + 0.0003
        self.topics.add_json("/base/traffic/received", {**received, "t_ns": ns(arrived_s)}, ns(arrived_s))

    def _fragment(
        self, stream: int, seq: int, index: int, count: int, priority: int, published_s: float, sent_s: float
    ) -> float | None:
        header = struct.pack("<4sHIQ", b"NLT1", stream, seq, ns(published_s)) if index == 0 else b""
        payload = header + bytes(1000 - len(header))
        topic = (b"telemetry", b"image")[stream] if index == 0 else b""
        data = encode_data_header(
            message_id=self._message_id,
            priority=priority,
            index=index,
            count=count,
            payload_bytes=len(payload),
            topic=topic,
        )
        number, arrived = self._send("robot1", "base", data + payload, sent_s)
        if arrived is not None:
            self._send(
                "base", "robot1", encode_ack([(number, number)], received_us=0, delay_us=0, room_bytes=99), arrived
            )
        return arrived

    def _exchange(self, at_s: float) -> None:
        """A probe and its answer: what they say does not matter."""
        _, arrived = self._send("base", "robot1", bytes([5]), at_s)
        if arrived is not None:
            self._send("robot1", "base", bytes([5]), arrived + 0.001)

    def _send(self, sender: str, receiver: str, frames: bytes, at_s: float) -> tuple[int, float | None]:
        """One datagram over the air; returns its number and when it arrived, None if it was lost."""
        self._numbers[sender] += 1
        number = self._numbers[sender]
        tag = tag_of(EPOCHS[receiver])
        datagram = encode_header(epoch=EPOCHS[sender], destination_tag=tag, packet_number=number, flags=0) + frames
        frame = ethernet(sender, receiver, datagram)
        self._packet(sender, frame, Direction.OUTBOUND, at_s)
        out = OUTAGE_S[0] <= at_s < OUTAGE_S[1]
        lost = out or self._rng.random() < self._loss_ratio
        verdict = Verdict.OUTAGE if out else Verdict.LOST if lost else Verdict.DELIVERED
        ends = encode_verdict_ends((sender, "radio0"), (receiver, "radio0"))
        arrived_s = at_s + DELAY_S
        body = encode_verdict(ends, verdict, 0 if lost else ns(arrived_s), len(frame), zlib.crc32(frame))
        body += encode_attempts(1, -50 - round(2 * at_s))
        self._writer.add_message(self.topics.verdicts(), ns(at_s), ns(at_s), body)
        if lost:
            return number, None
        self._packet(receiver, frame, Direction.INBOUND, arrived_s)
        return number, arrived_s

    def _packet(self, node: str, frame: bytes, direction: Direction, at_s: float) -> None:
        channel, linktype = self.topics.packets(node, "radio0", 1)
        names = encode_packet_names(node, "radio0")
        head = encode_packet(zlib.crc32(frame), len(frame), linktype, direction, names, len(frame))
        self._writer.add_message(channel, ns(at_s), ns(at_s), head, frame)


def ethernet(sender: str, receiver: str, payload: bytes) -> bytes:
    """A UDP datagram over IPv4 over Ethernet."""
    udp = struct.pack("!HHHH", 4200, 4200, 8 + len(payload), 0) + payload
    ends = ADDRESSES[sender] + ADDRESSES[receiver]
    ip = struct.pack("!BBHHHBBH", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0) + ends
    return MACS[receiver] + MACS[sender] + b"\x08\x00" + ip + udp


MakeMission = Callable[..., Path]


@pytest.fixture(scope="session")
def make_mission(tmp_path_factory: pytest.TempPathFactory) -> MakeMission:
    def make(name: str = "mission", *, loss_ratio: float = 0.03, seed: int = 1) -> Path:
        path = tmp_path_factory.mktemp("captures") / f"{name}.mcap"
        Mission(path, loss_ratio=loss_ratio, seed=seed).run()
        return path

    return make
