"""From a capture's records to a :class:`Trace`."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from netlab.capture.decoders import mesh_of, traffic_in, udp_of
from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind, PacketRecord, VerdictRecord
from netlab.capture.schemas import Direction
from netlab.errors import CaptureError
from netlab.traces.links import KernelCounts, PacketLinks
from netlab.traces.model import (
    EVERYBODY,
    Delivery,
    Fragment,
    Interface,
    LinkCounts,
    LinkState,
    Presence,
    Published,
    Remark,
    Step,
    Stream,
    Trace,
    Window,
    killed_daemon,
)
from udp_mesh.core.wire import tag_of

_KINDS = frozenset(Kind) - {Kind.VERDICT, Kind.LOG, Kind.MAP, Kind.POSES}


def load_trace(path: Path | str) -> Trace:
    """Read all that the questions need.

    Raises:
        CaptureError: The file is no capture, or its metadata is damaged.
    """
    with Capture.open(path) as capture:
        return read_trace(capture)


def read_trace(capture: Capture, *, with_packets: bool = True) -> Trace:
    """As :func:`load_trace`, of an open capture.

    Args:
        capture: It stays open.
        with_packets: Without packets and verdicts, ``fragments`` and ``links`` stay empty: far less time and memory.
    """
    loader = _Loader(capture)
    kinds, tally = (_KINDS, loader.verdict) if with_packets else (_KINDS - {Kind.PACKET}, None)
    for record in capture.records(kinds, tally=tally, with_inbound=loader.needs_inbound):
        if isinstance(record, PacketRecord):
            loader.packet(record)
        elif isinstance(record, JsonRecord):
            loader.json(record)
    return loader.finish(list(capture.notes))


class _Sent(NamedTuple):
    """A fragment as it left, whole only when all has been read: its time, interface, epoch, message id, index, count
    and priority."""

    fragment: tuple[int, Interface, int, int, int, int, int]
    tag: int | None  # of the destination; None for everybody
    address: str  # of a broadcast
    packet_number: int
    frame_bytes: int


class _Loader:
    def __init__(self, capture: Capture) -> None:
        self._trace = Trace(path=str(capture.path), t0_ns=capture.t0_ns)
        self._nodes: dict[int, str] = {}  # an epoch's tag -> the node that sends with it
        self._packet_links: PacketLinks | None = None  # only where the medium tells no verdicts
        self._wire_ids: dict[tuple[str, int], int] = {}  # of messages that were begun anew, by node and first id
        self._sent: list[_Sent] = []
        self._messages: dict[tuple[str, int, int], tuple[int, int]] = {}
        self._interfaces: dict[tuple[str, str | None], Interface] = {}  # by (node, segment)
        self._pair_rates: dict[Interface, dict[str, float | None]] = {}  # by interface and receiving node
        self._take: dict[Kind, Callable[[JsonRecord], None]] = {
            Kind.TIMELINE: self._step,
            Kind.PUBLISHED: self._published,
            Kind.RECEIVED: self._received,
            Kind.EVENT: self._event,
            Kind.LINKS: self._link,
        }
        try:
            self._describe(capture)
        except (ValueError, KeyError, TypeError) as error:
            raise CaptureError(f"{capture.path}: metadata of the run is damaged: {error!r}") from None

    def _describe(self, capture: Capture) -> None:
        metadata, trace = capture.metadata, self._trace
        end_s = trace.seconds(capture.end_ns)
        trace.duration_s = float(metadata.get("duration_s", end_s))
        trace.streams = tuple(
            Stream(
                int(item["stream"]),
                item["source"],
                item["destination"],
                item["topic"],
                int(item["priority"]),
                item.get("keep") == "latest",
            )
            for item in json.loads(metadata.get("streams", "[]"))
        )
        for port in json.loads(metadata.get("ports", "[]")):
            self._interfaces[port["node"], port.get("segment")] = interface = (port["node"], port["interface"])
            trace.segments[interface] = str(port.get("segment") or "")
            if port.get("mac"):
                trace.macs[bytes.fromhex(port["mac"].replace(":", ""))] = interface
            if port.get("rate_bps"):
                trace.rates_bps[interface] = [(0, float(port["rate_bps"]))]
        for port in (*json.loads(metadata.get("ports", "[]")), *json.loads(metadata.get("meshes", "[]"))):
            if port.get("address"):
                trace.addresses[port["address"].split("/")[0]] = port["node"]
        planned = set(self._interfaces.values())
        seen = {
            (topic.metadata.get("node"), topic.metadata.get("interface"))
            for topic in capture.topics
            if topic.kind is Kind.PACKET
        }
        trace.is_meshed = bool(planned) and bool(seen - planned)
        if not any(topic.kind is Kind.VERDICT for topic in capture.topics):
            self._packet_links = PacketLinks(trace.macs)
        for stream in trace.streams:
            trace.published[stream.index], trace.delivered[stream.index] = [], []

    @property
    def needs_inbound(self) -> bool:
        """Whether packets that came in tell anything: what became of frames, where no verdicts do."""
        return self._packet_links is not None

    def json(self, record: JsonRecord) -> None:
        self._take[record.kind](record)

    def packet(self, record: PacketRecord) -> None:
        if self._packet_links is not None:
            self._packet_links.packet(record)
        if record.direction is not Direction.OUTBOUND:
            return
        datagram = udp_of(record.frame, record.linktype)
        mesh = mesh_of(datagram) if datagram else None
        if datagram is None or mesh is None:
            return
        self._nodes[tag_of(mesh.epoch)] = record.node
        here = (record.node, record.interface)
        tag, address = (None, datagram.destination) if mesh.is_broadcast else (mesh.destination_tag, "")
        for piece in mesh.fragments:
            message_id, priority, _, index, count, _, _ = piece
            if header := traffic_in(piece):
                self._messages[record.node, mesh.epoch, message_id] = (header.stream, header.seq)
            fragment = (record.t_ns, here, mesh.epoch, message_id, index, count, priority)
            self._sent.append(_Sent(fragment, tag, address, mesh.packet_number, record.original_length))

    def verdict(self, record: VerdictRecord, count: int) -> None:
        """Take what the medium decided of ``count`` frames alike."""
        counts = self._trace.links.setdefault((record.sender, record.receiver), LinkCounts())
        counts.frames += count
        counts.size_bytes += record.length * count
        counts.verdicts[record.verdict] = counts.verdicts.get(record.verdict, 0) + count

    def finish(self, notes: list[str]) -> Trace:
        trace = self._trace
        for sent in self._sent:
            fragment = self._fragment(sent)
            trace.fragments.setdefault(fragment.node, []).append(fragment)
        if self._packet_links is not None:
            trace.links = self._packet_links.counts()
        trace.notes = notes
        return trace

    def _fragment(self, sent: _Sent) -> Fragment:
        """With what is only known at the end: whose tag it is, of which message, and whether it was a copy."""
        t_ns, (node, _), epoch, message_id, index, _, _ = sent.fragment
        destination = EVERYBODY if sent.tag is None else self._nodes.get(sent.tag, "")
        copied_as = (node, destination, sent.packet_number, message_id, index)
        is_copy = self._trace.daemons.is_copy(copied_as, t_ns)
        message = self._messages.get((node, epoch, message_id))
        return Fragment(*sent.fragment, destination, sent.frame_bytes, message, is_copy, sent.address)

    def _step(self, record: JsonRecord) -> None:
        restores, *meshed = (record.payload.get(key) for key in ("restores", "reroutes", "rejoins"))
        reroutes, rejoins = (_node_pairs(value if isinstance(value, list) else []) for value in meshed)
        pair = next(iter(_node_pairs([restores])), None)
        at_s = record.payload.get("at_s")
        planned_s = float(at_s) if isinstance(at_s, int | float) else self._trace.seconds(record.t_ns)
        label, kind = record.text("label"), record.text("kind")
        self._trace.timeline.append(Step(record.t_ns, planned_s, label, kind, pair, reroutes, rejoins))
        if killed := killed_daemon(label) if kind == "kill" else None:
            self._trace.daemons.restart(record.t_ns, killed)

    def _link(self, record: JsonRecord) -> None:
        """One directed pair's new state. An interface is as fast as the slowest of its pairs."""
        self._note_state(record)
        interface = self._interfaces.get((record.text("from"), record.text("segment")))
        if interface is None:
            return
        impairment = record.payload.get("impairment")
        self._link_state(record, interface, impairment)
        rate = impairment.get("rate_bps") if isinstance(impairment, dict) else None
        pairs = self._pair_rates.setdefault(interface, {})
        pairs[record.text("to")] = float(rate) if isinstance(rate, int | float) else None
        slowest = min((value for value in pairs.values() if value), default=None)
        changes = self._trace.rates_bps.setdefault(interface, [])
        if not changes or changes[-1][1] != slowest:
            changes.append((record.t_ns, slowest))

    def _note_state(self, record: JsonRecord) -> None:
        words = record.payload.get("impairment")
        delay_s, jitter_s, rate_bps = (
            float(value) if isinstance(words, dict) and isinstance(value := words.get(key), int | float) else None
            for key in ("delay_s", "jitter_s", "rate_bps")
        )
        key = (record.text("from"), record.text("to"), record.text("segment"))
        new = LinkState(record.t_ns, record.text("state"), delay_s, jitter_s or 0.0, rate_bps)
        states = self._trace.states.setdefault(key, [])
        if not states or replace(states[-1], t_ns=new.t_ns) != new:
            states.append(new)

    def _link_state(self, record: JsonRecord, sender: Interface, impairment: object) -> None:
        receiver = self._interfaces.get((record.text("to"), record.text("segment")))
        if self._packet_links is None or receiver is None:
            return
        corrupts = isinstance(impairment, dict) and bool(impairment.get("corrupt_ratio"))
        counters, counts = record.payload.get("counters"), None
        if isinstance(counters, dict):
            full, waiting, reordered = (counters.get(key) for key in ("queue_full", "waiting", "reordered"))
            if isinstance(full, int | None) and isinstance(waiting, int) and isinstance(reordered, int):
                counts = KernelCounts(full, waiting, reordered)
        self._packet_links.state((sender, receiver), record.text("state"), corrupts=corrupts, counts=counts)

    def _published(self, record: JsonRecord) -> None:
        stream = record.number("stream")
        publication = record.number("publication") if "publication" in record.payload else stream
        accepted = record.payload.get("accepted", True) is True
        reason = record.text("reason") or None
        size_bytes, seq = record.number("size_bytes"), record.number("seq")
        entry = Published(stream, publication, seq, record.t_ns, size_bytes, accepted, reason)
        self._trace.published.setdefault(stream, []).append(entry)

    def _received(self, record: JsonRecord) -> None:
        stream, seq, published_ns = record.number("stream"), record.number("seq"), record.number("published_ns")
        entry = Delivery(stream, seq, published_ns, record.t_ns, record.number("size_bytes"))
        self._trace.delivered.setdefault(stream, []).append(entry)

    def _event(self, record: JsonRecord) -> None:
        trace, pair = self._trace, (record.node, record.text("peer"))
        trace.daemons.take(record.t_ns, record.node, record.payload)
        match record.text("event"):
            case "peer_up" | "peer_down" as change:
                presence = trace.presence.setdefault(pair, Presence())
                presence.t_ns.append(record.t_ns)
                presence.online.append(change == "peer_up")
                self._remark(record, f"{pair[1]} {change[5:]} ({record.text('reason')})")
            case "window":
                window = Window(record.t_ns, record.number("cwnd_bytes"), record.number("in_flight_bytes"))
                trace.windows.setdefault(pair, []).append(window)
            case "message_begun_anew":
                self._wire_ids[record.node, record.number("message_id")] = record.number("wire_id")
            case "message_dropped":
                key = (record.node, record.number("message_id"))
                for on_wire in {key[1], self._wire_ids.get(key, key[1])}:
                    trace.dropped_ns.setdefault((record.node, on_wire), []).append(record.t_ns)
                text = f"dropped message {key[1]} of {record.text('topic')} to {pair[1]} ({record.text('reason')})"
                self._remark(record, text)

    def _remark(self, record: JsonRecord, text: str) -> None:
        self._trace.remarks.append(Remark(record.t_ns, record.node, text))


def _node_pairs(values: list[object]) -> tuple[tuple[str, str], ...]:
    return tuple((str(value[0]), str(value[1])) for value in values if isinstance(value, list) and len(value) == 2)
