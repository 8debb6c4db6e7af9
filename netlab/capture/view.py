"""Records as lines of text or JSON objects for people and scripts, and the filters that choose among them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field

from netlab.capture.decoders import mesh_of, peel, udp_of
from netlab.capture.describe import describe_frame
from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind, LogLine, PacketRecord, Record, VerdictRecord
from netlab.capture.schemas import Direction
from udp_mesh.core.wire import Dissection

_NODELESS = {Kind.VERDICT, Kind.TIMELINE, Kind.LINKS, Kind.MAP, Kind.POSES}
_ARROWS = {Direction.INBOUND: "<-", Direction.OUTBOUND: "->", Direction.UNKNOWN: "--"}


@dataclass(frozen=True, slots=True)
class Filter:
    """What to show; None shows all. Times are scenario seconds."""

    node: str | None = None
    peer: str | None = None
    topic: str | None = None
    priority: int | None = None
    from_s: float | None = None
    to_s: float | None = None

    @property
    def chooses_messages(self) -> bool:
        """Whether only what belongs to application messages is wanted."""
        return self.topic is not None or self.priority is not None


@dataclass(slots=True)
class View:
    """Chooses and renders the records of one capture."""

    capture: Capture
    filter: Filter
    _nodes: dict[str, str] = field(default_factory=dict)  # address -> node
    _topics: dict[tuple[int, int], str] = field(default_factory=dict)  # (epoch, message id) -> topic

    def __post_init__(self) -> None:
        """Learn the addresses of the nodes."""
        try:
            for key in ("ports", "meshes"):
                for port in json.loads(self.capture.metadata.get(key, "[]")):
                    if port.get("address"):
                        self._nodes[port["address"].split("/")[0]] = port["node"]
        except (ValueError, AttributeError, KeyError, TypeError):
            self._nodes = {}  # another program's metadata: the peers of packets stay unknown

    def records(self, kinds: set[Kind]) -> Iterator[Record]:
        """The chosen records in the order of time."""
        chosen, t0_ns = self.filter, self.capture.t0_ns
        start_ns = 0 if chosen.from_s is None else max(0, t0_ns + round(chosen.from_s * 1e9))
        end_ns = 1 << 64 if chosen.to_s is None else max(0, t0_ns + round(chosen.to_s * 1e9))
        # Verdicts, timeline and links live on topics of no node, so they are asked for without one.
        nodes = None if chosen.node is None or kinds & _NODELESS else {chosen.node}
        for record in self.capture.records(kinds, nodes=nodes, start_ns=start_ns, end_ns=end_ns):
            if self._wanted(record):
                yield record

    def wants(self, record: Record) -> bool:
        """Whether a record, however it was found, is among the chosen ones."""
        at_s, chosen = (record.t_ns - self.capture.t0_ns) / 1e9, self.filter
        in_time = (chosen.from_s is None or at_s >= chosen.from_s) and (chosen.to_s is None or at_s < chosen.to_s)
        return in_time and self._wanted(record)

    def time(self, t_ns: int) -> str:
        """Scenario time in a column of its own."""
        return f"{(t_ns - self.capture.t0_ns) / 1e9:12.6f}"

    def text(self, record: Record) -> str:
        """One line, beginning with the scenario time."""
        if isinstance(record, PacketRecord):
            where = f"{record.node}/{record.interface}"
            body = f"{where:<16} {_ARROWS[record.direction]} {describe_frame(record.frame, record.linktype)}"
        elif isinstance(record, VerdictRecord):
            ends = f"{'/'.join(record.sender)} > {'/'.join(record.receiver)}"
            body = f"{ends:<34} {record.verdict.name.lower():<12} {record.length} B"
        elif isinstance(record, LogLine):
            body = f"{record.node}/{record.process}: {record.level.name:<7} {record.message}"
        else:
            rest = " ".join(f"{key}={_plain(value)}" for key, value in _details(record).items())
            name = record.text("event") or record.text("kind") or record.kind.value
            body = f"{record.node or '-':<12} {name:<22} {rest}"
        return f"{self.time(record.t_ns)}  {body}".rstrip()

    def json(self, record: Record) -> dict[str, object]:
        """The same as an object; ``t_s`` is scenario time."""
        head: dict[str, object] = {"t_s": (record.t_ns - self.capture.t0_ns) / 1e9, "t_ns": record.t_ns}
        if isinstance(record, PacketRecord):
            return head | {
                "kind": "packet",
                "node": record.node,
                "interface": record.interface,
                "direction": record.direction.name.lower(),
                "length": record.original_length,
                "crc32": record.crc32,
                "info": describe_frame(record.frame, record.linktype),
            }
        if isinstance(record, VerdictRecord):
            return head | {
                "kind": "verdict",
                "sender": "/".join(record.sender),
                "receiver": "/".join(record.receiver),
                "verdict": record.verdict.name.lower(),
                "departs_ns": record.departs_ns,
                "length": record.length,
                "crc32": record.crc32,
            }
        if isinstance(record, LogLine):
            where = {"kind": "log", "node": record.node, "process": record.process}
            return head | where | {"level": record.level.name.lower(), "message": record.message}
        return record.payload | head | {"topic": record.topic, "node": record.node}

    def _wanted(self, record: Record) -> bool:
        chosen = self.filter
        if isinstance(record, PacketRecord):
            return (chosen.node in (None, record.node)) and self._packet_wanted(record)
        if isinstance(record, VerdictRecord):
            ends = {record.sender[0], record.receiver[0]}
            return (
                all(node is None or node in ends for node in (chosen.node, chosen.peer)) and not chosen.chooses_messages
            )
        if isinstance(record, LogLine):
            return chosen.node in (None, record.node)
        payload = record.payload
        if record.kind in _NODELESS:
            return True
        return (
            chosen.node in (None, record.node)
            and chosen.peer in (None, payload.get("peer"), payload.get("source"))
            and chosen.topic in (None, payload.get("topic"))
            and chosen.priority in (None, payload.get("priority"))
        )

    def _packet_wanted(self, record: PacketRecord) -> bool:
        chosen = self.filter
        if chosen.peer is None and not chosen.chooses_messages:
            return True
        datagram = udp_of(peel(record.frame)[1], record.linktype)
        if datagram is None:
            return False
        ends = {self._nodes.get(datagram.source), self._nodes.get(datagram.destination)}
        if chosen.peer is not None and chosen.peer not in ends:
            return False
        mesh = mesh_of(datagram) if chosen.chooses_messages else None
        return not chosen.chooses_messages or (mesh is not None and self._carries(mesh))

    def _carries(self, mesh: Dissection) -> bool:
        """Whether a datagram carries a chosen message. Only fragment 0 names the topic: it is remembered."""
        carries = False
        for piece in mesh.fragments:
            key = (mesh.epoch, piece.message_id)
            if piece.topic is not None:
                self._topics[key] = piece.topic
            topic_fits = self.filter.topic in (None, self._topics.get(key))
            carries |= topic_fits and self.filter.priority in (None, piece.priority)
        return carries


def _details(record: JsonRecord) -> dict[str, object]:
    hidden = {"t_ns", "event"} | ({"kind"} if record.kind is Kind.TIMELINE else set())
    return {key: value for key, value in record.payload.items() if key not in hidden and value is not None}


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) and " " not in value else json.dumps(value)
