"""Captures told in a few words: real udp_mesh datagrams between nodes a and b, written as a run would."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

from netlab.capture.schemas import Direction, encode_packet, encode_packet_names, encode_verdict, encode_verdict_ends
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.medium.verdicts import Verdict
from udp_mesh.core import wire

T0_NS = 1_800_000_000_000_000_000
EPOCHS = {"a": 7 << 32 | 0xA, "b": 9 << 32 | 0xB}
STREAMS = [
    {"stream": 0, "source": "a", "destination": "b", "topic": "telemetry", "priority": 1, "keep": "all"},
    {"stream": 1, "source": "a", "destination": "b", "topic": "bulk", "priority": 9, "keep": "latest"},
]
PORTS = [
    {"node": "a", "interface": "eth0", "address": "10.1.0.1/24", "rate_bps": 1e7},
    {"node": "b", "interface": "eth0", "address": "10.1.0.2/24", "rate_bps": None},
]


def frame(sender: str, body: bytes, *, number: int, broadcast: bool = False, last_byte: int | None = None) -> bytes:
    """A datagram from one to the other; ``last_byte`` of its destination's address, if it is another."""
    receiver = "b" if sender == "a" else "a"
    tag, flags = (0, wire.FLAG_UNNUMBERED) if broadcast else (wire.tag_of(EPOCHS[receiver]), 0)
    payload = wire.encode_header(epoch=EPOCHS[sender], destination_tag=tag, packet_number=number, flags=flags) + body
    ends = bytes([10, 1, 0, 1, 10, 1, 0, 2]) if sender == "a" else bytes([10, 1, 0, 2, 10, 1, 0, 1])
    ends = ends if last_byte is None else ends[:-1] + bytes([last_byte])
    udp = struct.pack("!HHHH", 8700, 8700, 8 + len(payload), 0) + payload
    return bytes(12) + b"\x08\x00" + struct.pack("!BBHHHBBH", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0) + ends + udp


def data(stream: int, seq: int, *, message_id: int, index: int = 0, count: int = 1) -> bytes:
    topic, priority = STREAMS[stream]["topic"], STREAMS[stream]["priority"]
    payload = struct.pack("<4sHIQ", b"NLT1", stream, seq, T0_NS) + bytes(100) if index == 0 else bytes(118)
    head = wire.encode_data_header(
        message_id=message_id,
        priority=int(str(priority)),
        index=index,
        count=count,
        payload_bytes=len(payload),
        topic=str(topic).encode(),
    )
    return head + payload


class Writer:
    def __init__(self, path: Path, metadata: dict[str, str] | None = None) -> None:
        self.path, self.writer = path, CaptureWriter(path)
        self.topics = Topics(self.writer)
        base = {"name": "pair", "t0_ns": str(T0_NS), "duration_s": "2.0"}
        told = {"streams": json.dumps(STREAMS), "ports": json.dumps(PORTS)}
        self.writer.add_metadata("netlab.run", base | told | (metadata or {}))

    def packet(self, node: str, at_s: float, content: bytes, direction: Direction) -> None:
        channel, linktype = self.topics.packets(node, "eth0", 1)
        names, crc = encode_packet_names(node, "eth0"), zlib.crc32(content)
        head = encode_packet(crc, len(content), linktype, direction, names, len(content))
        t_ns = T0_NS + round(at_s * 1e9)
        self.writer.add_message(channel, t_ns, t_ns, head, content)

    def crossing(self, at_s: float, content: bytes, verdict: Verdict = Verdict.DELIVERED) -> None:
        self.packet("a", at_s, content, Direction.OUTBOUND)
        t_ns = T0_NS + round(at_s * 1e9)
        ends = encode_verdict_ends(("a", "eth0"), ("b", "eth0"))
        body = encode_verdict(ends, verdict, 0, len(content), zlib.crc32(content))
        self.writer.add_message(self.topics.verdicts(), t_ns, t_ns, body)
        if verdict is Verdict.DELIVERED:
            self.packet("b", at_s + 0.02, content, Direction.INBOUND)

    def json(self, topic: str, at_s: float, /, **payload: object) -> None:
        t_ns = T0_NS + round(at_s * 1e9)
        self.topics.add_json(topic, {"t_ns": t_ns, **payload}, t_ns)


class Play(Writer):
    """Messages from a to b over a link of 20 ms and 1 Mbit/s, step by step; times in scenario seconds.

    ``a`` has met ``b`` half a second before t = 0.
    """

    def __init__(self, path: Path, metadata: dict[str, str] | None = None) -> None:
        ports = [
            port | {"segment": "a-b", "mac": f"02:00:00:00:00:0{number}"} for number, port in enumerate(PORTS, start=1)
        ]
        super().__init__(path, {"ports": json.dumps(ports)} | (metadata or {}))
        self.link(-1.0)
        self.event(-0.5, "peer_up", epoch=EPOCHS["b"], reason="discovered")

    def link(self, at_s: float, state: str = "up") -> None:
        """Both directions of the link from now on."""
        for sender, receiver in (("a", "b"), ("b", "a")):
            words = {"delay_s": 0.02, "jitter_s": 0.0, "rate_bps": 1e6}
            row = {"segment": "a-b", "from": sender, "to": receiver, "state": state, "impairment": words}
            self.json("/links", at_s, **row)

    def step(self, at_s: float, kind: str, label: str) -> None:
        self.json("/timeline", at_s, kind=kind, label=label, at_s=at_s)

    def event(self, at_s: float, name: str, *, node: str = "a", **fields: object) -> None:
        """What a node's daemon says."""
        peer = {} if node != "a" else {"peer": "b"}
        self.json(f"/{node}/udp_mesh/events", at_s, event=name, **{**peer, **fields})

    def publish(self, stream: int, seq: int, at_s: float, *, accepted: bool = True, reason: str | None = None) -> None:
        told = {"stream": stream, "seq": seq, "size_bytes": 118, "accepted": accepted, "reason": reason}
        self.json("/a/traffic/published", at_s, event="published", **told)

    def queue(self, stream: int, message_id: int, at_s: float, *, fragments: int = 1, **fields: object) -> None:
        about = {"topic": STREAMS[stream]["topic"], "priority": STREAMS[stream]["priority"], "size_bytes": 118}
        numbers = {"message_id": message_id, "fragment_count": fragments}
        self.event(at_s, "message_queued", **{**about, **numbers, **fields})

    def send(
        self,
        stream: int,
        seq: int,
        at_s: float,
        *,
        message_id: int,
        number: int,
        index: int = 0,
        count: int = 1,
        arrives_s: float | None = None,
        verdict: Verdict = Verdict.DELIVERED,
        epoch_b: int | None = None,
    ) -> None:
        """A fragment leaves a, and arrives if ``arrives_s`` says when; the medium tells its verdict."""
        body = data(stream, seq, message_id=message_id, index=index, count=count)
        self.transmit(body, at_s, number=number, arrives_s=arrives_s, verdict=verdict, epoch_b=epoch_b)

    def transmit(
        self,
        body: bytes,
        at_s: float,
        *,
        number: int,
        arrives_s: float | None,
        verdict: Verdict | None = None,
        epoch_b: int | None = None,
    ) -> None:
        """A packet with any frames leaves a, and arrives if ``arrives_s`` says when."""
        content = self.frame(body, number, epoch_b)
        if verdict is None:
            verdict = Verdict.LOST if arrives_s is None else Verdict.DELIVERED
        self.packet("a", at_s, content, Direction.OUTBOUND)
        ends = encode_verdict_ends(("a", "eth0"), ("b", "eth0"))
        departs_ns = 0 if arrives_s is None else T0_NS + round(arrives_s * 1e9)
        body = encode_verdict(ends, verdict, departs_ns, len(content), zlib.crc32(content))
        t_ns = T0_NS + round(at_s * 1e9) + 1000
        self.writer.add_message(self.topics.verdicts(), t_ns, t_ns, body)
        if arrives_s is not None:
            self.packet("b", arrives_s, content, Direction.INBOUND)

    def frame(self, body: bytes, number: int, epoch_b: int | None = None) -> bytes:
        content = bytearray(frame("a", body, number=number))
        content[:12] = bytes.fromhex("020000000002020000000001")
        if epoch_b is not None:
            struct.pack_into("!I", content, 14 + 20 + 8 + 12, wire.tag_of(epoch_b))
        return bytes(content)

    def hear(self, at_s: float, body: bytes, *, number: int = 900, epoch: int | None = None) -> None:
        """A datagram of b reaches a."""
        content = bytearray(frame("b", body, number=number))
        if epoch is not None:
            struct.pack_into("!Q", content, 14 + 20 + 8 + 4, epoch)
        self.packet("a", at_s, bytes(content), Direction.INBOUND)

    def acknowledge(self, at_s: float, first: int, last: int | None = None, *, epoch: int | None = None) -> None:
        """b's acknowledgement of packets reaches a."""
        ranges = [(first, first if last is None else last)]
        self.hear(at_s, wire.encode_ack(ranges, received_us=0, delay_us=0, room_bytes=500), epoch=epoch)

    def receive(
        self, stream: int, seq: int, at_s: float, *, published_s: float, message_id: int, daemon_s: float
    ) -> None:
        """b's daemon has it whole, then b's application."""
        about = {"message_id": message_id, "topic": STREAMS[stream]["topic"], "source": "a", "size_bytes": 118}
        self.event(daemon_s, "message_delivered", node="b", **about)
        published_ns = T0_NS + round(published_s * 1e9)
        told = {"stream": stream, "seq": seq, "published_ns": published_ns, "size_bytes": 118, "source": "a"}
        self.json("/b/traffic/received", at_s, event="received", **told)
