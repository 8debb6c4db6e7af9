"""What a live screen shows of a lab: records in, state out. Pure: no clock, no socket, no terminal.

Feed it with :meth:`LiveModel.describe` (metadata) and :meth:`LiveModel.take` (records in any order of arrival).
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from netlab.capture.records import JsonRecord, Kind, LogLine, Record
from netlab.capture.schemas import LogLevel
from netlab.live.links import Grade, Link
from netlab.live.queues import Queues
from netlab.live.windows import LatencyWindow

_NS_PER_S = 1_000_000_000
_LOG_LINES = 200
Point = tuple[float, float]


@dataclass(slots=True)
class Peer:
    """How one node's daemon sees another one. Times in seconds, rate in bit/s; None: not told yet."""

    online: bool = False
    srtt_s: float | None = None
    rate_bps: float | None = None
    in_flight_bytes: int = 0
    cwnd_bytes: int = 0


@dataclass(slots=True)
class Node:
    """One node."""

    name: str
    position_m: Point | None = None
    heading_deg: float = 0.0
    active: bool = True
    peers: dict[str, Peer] = field(default_factory=dict)
    queues: Queues = field(default_factory=Queues)
    retransmissions: int = 0
    log: deque[tuple[float, str, LogLevel, str]] = field(default_factory=lambda: deque(maxlen=_LOG_LINES))

    @property
    def online(self) -> list[str]:
        """Its peers that are online."""
        return sorted(name for name, peer in self.peers.items() if peer.online)


@dataclass(slots=True)
class Stream:
    """One stream of messages with what has become of them."""

    index: int
    source: str
    destination: str
    topic: str
    priority: int
    sent: int = 0
    window: LatencyWindow = field(default_factory=LatencyWindow)
    seen: set[int] = field(default_factory=set)


@dataclass(frozen=True, slots=True)
class Tunnel:
    """One tunnel of the map, metres."""

    name: str
    path_m: tuple[Point, ...]
    width_m: float


@dataclass(frozen=True, slots=True)
class Moment:
    """One row of the timeline; ``at_s`` is when it was done, ``by_hand`` whether a person did it."""

    at_s: float
    kind: str
    label: str
    by_hand: bool


@dataclass(slots=True)
class LiveModel:
    """A lab as its records show it."""

    name: str = ""
    engine: str = ""
    t0_ns: int | None = None
    now_ns: int = 0
    nodes: dict[str, Node] = field(default_factory=dict)
    links: dict[frozenset[str], Link] = field(default_factory=dict)
    streams: dict[int, Stream] = field(default_factory=dict)
    priorities: dict[int, LatencyWindow] = field(default_factory=dict)
    tunnels: tuple[Tunnel, ...] = ()
    moments: deque[Moment] = field(default_factory=lambda: deque(maxlen=1000))

    def describe(self, metadata: Mapping[str, str]) -> None:
        """Take note of the record ``netlab.run``; may come again with more."""
        self.name, self.engine = metadata.get("name", self.name), metadata.get("engine", self.engine)
        if metadata.get("t0_ns", "").isdigit():
            self.t0_ns = int(metadata["t0_ns"])
        for port in _list(metadata.get("ports")):
            self._node(str(port["node"]))
        for row in _list(metadata.get("streams")):
            stream = Stream(int(row["stream"]), row["source"], row["destination"], row["topic"], int(row["priority"]))
            self._node(stream.source)
            self._node(stream.destination)
            self.streams.setdefault(stream.index, stream)

    def take(self, record: Record) -> None:
        """Take note of a record."""
        self.now_ns = max(self.now_ns, record.t_ns)
        if isinstance(record, LogLine):
            line = (self.seconds(record.t_ns), record.process, record.level, record.message)
            self._node(record.node).log.append(line)
        elif isinstance(record, JsonRecord):
            self._take_json(record)

    def seconds(self, t_ns: int) -> float:
        """Run time of a stamp; before t = 0 is known, negative from the newest record on."""
        return (t_ns - (self.now_ns if self.t0_ns is None else self.t0_ns)) / _NS_PER_S

    def shown_links(self) -> list[Link]:
        """The links that are worth a line on the map, by name: in range, and of nodes that nobody carries."""

        def is_shown(link: Link) -> bool:
            ends = (self.nodes.get(link.a), self.nodes.get(link.b))
            return link.grade is not Grade.OUT_OF_RANGE and all(node is None or node.active for node in ends)

        return sorted(filter(is_shown, self.links.values()), key=lambda link: link.name)

    def _take_json(self, record: JsonRecord) -> None:
        payload: Mapping[str, Any] = record.payload
        match record.kind:
            case Kind.EVENT:
                self._event(record.node, payload)
            case Kind.PUBLISHED:
                if (stream := self.streams.get(record.number("stream"))) is not None:
                    stream.sent += 1
            case Kind.RECEIVED:
                self._received(record)
            case Kind.LINKS:
                a, b = str(payload.get("from")), str(payload.get("to"))
                key = frozenset((a, b))
                if key not in self.links:
                    self.links[key] = Link(min(a, b), max(a, b))
                self.links[key].take(payload)
            case Kind.POSES:
                self._poses(payload)
            case Kind.MAP:
                self.tunnels = tuple(_tunnel(row) for row in payload.get("tunnels", ()))
            case Kind.TIMELINE:
                self._moment(record)

    def _received(self, record: JsonRecord) -> None:
        stream = self.streams.get(record.number("stream"))
        seq = record.number("seq")
        if stream is None or seq in stream.seen:
            return
        stream.seen.add(seq)
        now_s = record.t_ns / _NS_PER_S
        latency_s = (record.t_ns - record.number("published_ns")) / _NS_PER_S
        size_bytes = record.number("size_bytes")
        stream.window.add(latency_s, now_s=now_s, size_bytes=size_bytes)
        window = self.priorities.setdefault(stream.priority, LatencyWindow())
        window.add(latency_s, now_s=now_s, size_bytes=size_bytes)

    def _event(self, name: str, event: Mapping[str, Any]) -> None:
        node = self._node(name)
        match event.get("event"):
            case "peer_up" | "peer_down" as change:
                node.peers.setdefault(str(event.get("peer")), Peer()).online = change == "peer_up"
            case "window":
                peer = node.peers.setdefault(str(event.get("peer")), Peer())
                peer.srtt_s, peer.rate_bps = event.get("srtt_s"), event.get("rate_bps")
                peer.in_flight_bytes = int(event.get("in_flight_bytes") or 0)
                peer.cwnd_bytes = int(event.get("cwnd_bytes") or 0)
            case "fragment_retransmitted":
                node.retransmissions += 1
            case _:
                node.queues.take(event)

    def _poses(self, payload: Mapping[str, Any]) -> None:
        active = payload.get("active") or [True] * len(payload["nodes"])
        for name, pose, takes_part in zip(payload["nodes"], payload["poses"], active, strict=False):
            node = self._node(str(name))
            node.position_m = (float(pose["position"]["x"]), float(pose["position"]["y"]))
            node.active = bool(takes_part)

    def _moment(self, record: JsonRecord) -> None:
        if record.text("kind") == "exit":
            name, _, what = record.text("label").partition(": ")
            if name in self.nodes and what.startswith("udp_mesh "):
                self.nodes[name].queues.restarted()
                for peer in self.nodes[name].peers.values():
                    peer.online = False
        at_s = record.payload.get("at_s")
        when_s = float(at_s) if isinstance(at_s, int | float) else self.seconds(record.t_ns)
        self.moments.append(Moment(when_s, record.text("kind"), record.text("label"), "act" in record.payload))

    def _node(self, name: str) -> Node:
        node = self.nodes.get(name)
        if node is None:
            node = self.nodes[name] = Node(name)
        return node


def _list(text: str | None) -> list[dict[str, Any]]:
    try:
        rows = json.loads(text or "[]")
    except ValueError:
        return []
    return [row for row in rows if isinstance(row, dict)]


def _tunnel(row: Mapping[str, Any]) -> Tunnel:
    path = tuple((float(point[0]), float(point[1])) for point in row["path"])
    return Tunnel(str(row["name"]), path, float(row["width_m"]))
