"""Traffic sources and sinks: ordinary applications of udp_mesh that publish and receive what a scenario asks for.

One source and one sink process per node. Each writes a JSON line per message to its events descriptor (``published``
just before the publish call, ``received`` when the message is in the application's hands), so that the capture judges
by what applications saw and not by what a daemon claims. Every payload begins with :data:`PAYLOAD_HEADER`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import random
import select
import socket
import struct
import time
from collections import deque
from dataclasses import asdict, dataclass
from typing import BinaryIO

from netlab.lab.resolution import resolve
from udp_mesh.client import Client, ClientError, Message

#: magic, publication number, sequence number, time of the publish call (CLOCK_REALTIME, ns); little endian.
PAYLOAD_HEADER = struct.Struct("<4sHIQ")
MAGIC = b"NLT1"
REPORT_INTERVAL_S = 0.5
_RECONNECT_S = 0.02
_RECENT = 200  # latencies kept for the live status


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """One stream: a traffic entry of the scenario and one destination.

    ``publication`` is the number of the publishing act: the streams of an entry `to: all` share one, which then is a
    single publish to ``all``; it stands in the payload's header and equals the first such stream's number.
    """

    stream: int
    publication: int
    to_all: bool
    source: str
    destination: str
    topic: str
    size_bytes: int
    interval_s: float


def encode_streams(streams: list[StreamSpec]) -> str:
    """Streams as the JSON text that both programs take."""
    return json.dumps([asdict(stream) for stream in streams])


def source_main(argv: list[str]) -> int:
    """Publish streams; waits for the destinations to be discovered, then for the start command."""
    parser = argparse.ArgumentParser(prog="netlab-traffic-source")
    _common_arguments(parser)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--discovery-s", type=float, required=True, help="longest wait for destinations to be found")
    parser.add_argument("--await-peers", default="", help="comma-separated destinations that can be reached")
    parser.add_argument("--resolve-spread-s", type=float, help="have the kernels learn their link addresses, too")
    options = parser.parse_args(argv)
    streams = [StreamSpec(**fields) for fields in json.loads(options.streams)]
    with Client() as client:
        deadline = time.monotonic() + options.discovery_s
        awaited = [peer for peer in options.await_peers.split(",") if peer]
        for peer in awaited:
            client.wait_for_peer(peer, timeout_s=max(0.0, deadline - time.monotonic()))
        if options.resolve_spread_s is not None and awaited:
            addresses = sorted({peer.address for peer in client.peers() if peer.name in awaited})
            rng = random.Random(f"{options.seed}/resolve/{streams[0].source}")
            resolve(addresses, rng, spread_s=options.resolve_spread_s, deadline_s=deadline)
        os.write(options.ready_fd, b"READY=1\n")
        command = socket.socket(fileno=options.command_fd)
        start = json.loads(command.recv(4096) or b"null")
        if start is None:  # the lab ends before it began
            return 0
        with os.fdopen(options.events_fd, "wb", buffering=0) as events:
            source = _Source(client, streams, random.Random(f"{options.seed}/{streams[0].source}"))
            if start["late"]:
                source.skip((time.time_ns() - start["t0_ns"]) / 1e9)
            source.run(events, command, t0_ns=start["t0_ns"], duration_s=start["duration_s"])
    return 0


def sink_main(argv: list[str]) -> int:
    """Receive streams until told to stop or the process is ended."""
    parser = argparse.ArgumentParser(prog="netlab-traffic-sink")
    _common_arguments(parser)
    options = parser.parse_args(argv)
    streams = [StreamSpec(**fields) for fields in json.loads(options.streams)]
    command = socket.socket(fileno=options.command_fd)
    with Client() as client, os.fdopen(options.events_fd, "wb", buffering=0) as events:
        for topic in sorted({stream.topic for stream in streams}):
            client.subscribe(topic)
        os.write(options.ready_fd, b"READY=1\n")
        _receive(client, _Sink(streams), events, command)
    return 0


def _common_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--streams", required=True, help="JSON list of streams")
    for name in ("ready", "events", "command"):
        parser.add_argument(f"--{name}-fd", type=int, required=True)


class _Source:
    def __init__(self, client: Client, streams: list[StreamSpec], rng: random.Random) -> None:
        self._client = client
        by_publication: dict[int, list[StreamSpec]] = {}
        for stream in streams:
            by_publication.setdefault(stream.publication, []).append(stream)
        self._publications = list(by_publication.values())
        self._filler = rng.randbytes(max(stream.size_bytes for stream in streams))  # incompressible
        # Robots do not publish in lockstep: a seeded phase, below a tenth of a second so that t = 0 keeps its meaning.
        self._phase_s = [rng.uniform(0.0, min(0.1, streams[0].interval_s)) for streams in self._publications]
        self._sent = [0] * len(self._publications)

    def skip(self, late_s: float) -> None:
        """Leave out what was due in the first ``late_s`` seconds, while the node was still carried."""
        for index, (phase_s, streams) in enumerate(zip(self._phase_s, self._publications, strict=True)):
            self._sent[index] = max(0, math.ceil((late_s - phase_s) / streams[0].interval_s))

    def run(self, events: BinaryIO, command: socket.socket, *, t0_ns: int, duration_s: float) -> None:
        """Publish message k at t0 + phase + k * interval, as long as that lies before the duration.

        Until that is over, ``{"duration_s": ...}`` on ``command`` changes it.
        """
        next_report_s = REPORT_INTERVAL_S
        while True:
            due_s, index = min(
                (phase + sent * streams[0].interval_s, i)
                for i, (phase, sent, streams) in enumerate(
                    zip(self._phase_s, self._sent, self._publications, strict=True)
                )
            )
            told_s = _new_duration(command, t0_ns + round(min(due_s, duration_s) * 1e9))
            if told_s is not None:
                duration_s = told_s
                if duration_s > 0:
                    continue
            if due_s >= duration_s:
                break
            for record in self._publish(index):
                _write(events, record)
            if due_s >= next_report_s:
                next_report_s = due_s + REPORT_INTERVAL_S
                self._report(command)
        self._report(command)

    def _publish(self, index: int) -> list[dict[str, object]]:
        streams, seq = self._publications[index], self._sent[index]
        self._sent[index] += 1
        first = streams[0]
        published_ns = time.time_ns()
        header = PAYLOAD_HEADER.pack(MAGIC, first.publication, seq, published_ns)
        reason = None
        try:
            payload = header + self._filler[len(header) : first.size_bytes]
            self._client.publish(first.topic, payload, to="all" if first.to_all else first.destination)
        except ClientError as refusal:
            reason = str(refusal) or type(refusal).__name__
        return [
            {
                "event": "published",
                "stream": stream.stream,
                "publication": stream.publication,
                "seq": seq,
                "t_ns": published_ns,
                "size_bytes": stream.size_bytes,
                "accepted": reason is None,
                "reason": reason,
            }
            for stream in streams
        ]

    def _report(self, command: socket.socket) -> None:
        report: list[dict[str, object]] = [
            {"stream": stream.stream, "sent": sent}
            for streams, sent in zip(self._publications, self._sent, strict=True)
            for stream in streams
        ]
        _tell(command, report)


class _Sink:
    """What one node's applications have received so far."""

    def __init__(self, streams: list[StreamSpec]) -> None:
        self._by_publication = {stream.publication: stream for stream in streams}
        self._delivered: dict[int, set[int]] = {stream.stream: set() for stream in streams}
        self._recent_s: dict[int, deque[float]] = {stream.stream: deque(maxlen=_RECENT) for stream in streams}

    def receive(self, message: Message, *, t_ns: int) -> dict[str, object] | None:
        """The record of a message of our traffic, None for anything else."""
        if message.payload[:4] != MAGIC or len(message.payload) < PAYLOAD_HEADER.size:
            return None
        _magic, publication, seq, published_ns = PAYLOAD_HEADER.unpack_from(message.payload)
        stream = self._by_publication.get(publication)
        if stream is None:
            return None
        self._delivered[stream.stream].add(seq)
        latency_s = (t_ns - published_ns) / 1e9
        self._recent_s[stream.stream].append(latency_s)
        return {
            "event": "received",
            "stream": stream.stream,
            "seq": seq,
            "published_ns": published_ns,
            "t_ns": t_ns,
            "latency_s": latency_s,
            "size_bytes": len(message.payload),
            "source": message.source,
        }

    def report(self) -> list[dict[str, object]]:
        """Counts and recent latency, for the live status."""
        return [
            {"stream": number, "delivered": len(seqs), "latency_p50_s": _median(self._recent_s[number])}
            for number, seqs in self._delivered.items()
        ]


def _receive(client: Client, sink: _Sink, events: BinaryIO, command: socket.socket) -> None:
    next_report = time.monotonic() + REPORT_INTERVAL_S
    while True:
        while (message := client.receive(timeout_s=0)) is not None:
            record = sink.receive(message, t_ns=time.time_ns())
            if record is not None:
                _write(events, record)
        wait_s = max(0.0, next_report - time.monotonic())
        if _is_told(command, client, wait_s):  # anything, or its end, means stop
            return
        if time.monotonic() >= next_report:
            next_report = time.monotonic() + REPORT_INTERVAL_S
            _tell(command, sink.report())


def _is_told(command: socket.socket, client: Client, wait_s: float) -> bool:
    """Wait for a message, a command or the time; whether it was a command."""
    watched = [command.fileno()]
    try:
        watched.append(client.fileno())
    except ClientError:  # the daemon is away; the client's next receive() looks for it again
        wait_s = min(wait_s, _RECONNECT_S)
    return command.fileno() in select.select(watched, [], [], wait_s)[0]


def _write(events: BinaryIO, record: dict[str, object]) -> None:
    with contextlib.suppress(BrokenPipeError):  # the recorder is gone, which is not the traffic's business
        events.write(json.dumps(record).encode() + b"\n")


def _tell(command: socket.socket, report: list[dict[str, object]]) -> None:
    with contextlib.suppress(BlockingIOError, BrokenPipeError, ConnectionResetError):  # a status that nobody waits for
        command.send(json.dumps(report).encode(), socket.MSG_DONTWAIT)


def _median(values: deque[float]) -> float | None:
    return sorted(values)[len(values) // 2] if values else None


def _new_duration(command: socket.socket, deadline_ns: int) -> float | None:
    """Sleep until a time; a new duration that the lab tells meanwhile ends the sleep (0: the lab is gone)."""
    wait_s = max(0.0, (deadline_ns - time.time_ns()) / 1e9)
    while not select.select([command], [], [], wait_s)[0]:
        if (wait_s := (deadline_ns - time.time_ns()) / 1e9) <= 0:
            return None
    data = command.recv(4096)
    if not data:  # the lab is gone, and this process will be, too
        return 0.0
    return float(json.loads(data)["duration_s"])
