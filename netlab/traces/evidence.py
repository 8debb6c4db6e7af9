"""The packets of a stretch of time, sorted by what they prove: who sent which fragment when, where each datagram was
seen, what the medium decided on each frame, who acknowledged what.

A udp_mesh datagram is known by its sender's epoch, its number and its destination wherever it is seen: on its way it
may travel inside frames of a mesh, and change addresses at a bridge.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from itertools import islice

from netlab.capture.decoders import LINKTYPE_ETHERNET, mesh_of, peel, traffic_in, udp_of
from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord, VerdictRecord
from netlab.capture.schemas import Direction
from netlab.medium.verdicts import Verdict
from netlab.traces.model import Interface
from udp_mesh.core.wire import Dissection

PacketId = tuple[int, int, int]  # sender's epoch, packet number, destination's tag: each destination has its numbers
_DECIDED_WITHIN_NS = 500_000_000
_STAMP_SLACK_NS = 1_000_000


@dataclass(frozen=True, slots=True)
class Sighting:
    """A datagram at an interface. ``mesh``: what the frame around it belongs to, empty for none.

    ``mac_from``, ``mac_to``: of the outermost frame.
    """

    t_ns: int
    interface: Interface
    is_outbound: bool
    frame_bytes: int
    crc32: int
    mac_from: bytes
    mac_to: bytes
    mesh: str = ""


@dataclass(frozen=True, slots=True)
class Departure:
    """A fragment that left its sender. ``destination_tag``: low half of the receiver's epoch, 0 for a broadcast."""

    t_ns: int
    node: str
    packet: PacketId
    message_id: int
    index: int
    count: int
    priority: int
    payload_bytes: int
    destination_tag: int
    topic: str | None
    traffic: tuple[int, int] | None
    """(publication, seq) of netlab's own traffic; only fragment 0 tells."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The medium's verdict on one frame for one receiver."""

    t_ns: int
    receiver: Interface
    verdict: Verdict
    departs_ns: int
    attempts: int
    rssi_dbm: int | None


@dataclass(frozen=True, slots=True)
class AckHeard:
    """An acknowledgement that reached a node. ``ranges`` are inclusive packet numbers."""

    t_ns: int
    from_epoch: int
    ranges: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class BacklogHeard:
    """Another node said that something of this priority waits there."""

    t_ns: int
    from_epoch: int
    priority: int


@dataclass(slots=True, eq=False)
class Evidence:
    """What was seen in [start_ns, end_ns), of everything that one node sent and of what it heard in answer.

    Lists are in the order of time. ``has_verdicts``: the medium of this run tells its decisions.
    """

    node: str
    start_ns: int
    end_ns: int
    has_verdicts: bool = False
    departures: list[Departure] = field(default_factory=list)
    sightings: dict[PacketId, list[Sighting]] = field(default_factory=lambda: defaultdict(list))
    acks: list[AckHeard] = field(default_factory=list)
    backlogs: list[BacklogHeard] = field(default_factory=list)
    epochs: set[int] = field(default_factory=set)
    _decisions: dict[tuple[Interface, int], list[Decision]] = field(default_factory=lambda: defaultdict(list))

    def decisions(self, sent: Sighting) -> list[Decision]:
        """What the medium decided on a frame that left: one per receiver, the first after it left."""
        found: dict[Interface, Decision] = {}
        earliest, latest = sent.t_ns - _STAMP_SLACK_NS, sent.t_ns + _DECIDED_WITHIN_NS
        for decision in self._decisions.get((sent.interface, sent.crc32), []):
            if earliest <= decision.t_ns <= latest and decision.verdict is not Verdict.DUPLICATED:
                found.setdefault(decision.receiver, decision)
        return list(found.values())

    def note_decision(self, frame: tuple[Interface, int], decision: Decision) -> None:
        """Take a decision on a frame, by the interface it left and its checksum."""
        self._decisions[frame].append(decision)

    def first_ack(self, packet: PacketId, *, after_ns: int, from_tag: int) -> int | None:
        """When the node first heard that a packet had arrived; None if it never did."""
        number = packet[1]
        start = bisect_right(self.acks, after_ns, key=lambda ack: ack.t_ns)
        for ack in islice(self.acks, start, None):
            is_theirs = ack.from_epoch & 0xFFFFFFFF == from_tag
            if is_theirs and any(first <= number <= last for first, last in ack.ranges):
                return ack.t_ns
        return None


def gather(capture: Capture, node: str, *, start_ns: int, end_ns: int) -> Evidence:
    """Read the packets and verdicts of a stretch of time, as far as they concern what ``node`` sent.

    Args:
        capture: It stays open.
        node: The sender.
        start_ns: CLOCK_REALTIME.
        end_ns: Up to before here.
    """
    return gather_all(capture, {node}, start_ns=start_ns, end_ns=end_ns)[node]


def gather_all(
    capture: Capture, nodes: Collection[str], *, start_ns: int, end_ns: int, with_verdicts: bool = True
) -> dict[str, Evidence]:
    """As :func:`gather`, for several senders at once; without verdicts it takes far less time."""
    has_verdicts = with_verdicts and any(topic.kind is Kind.VERDICT for topic in capture.topics)
    found = {node: Evidence(node, start_ns, end_ns, has_verdicts) for node in nodes}
    seen: list[tuple[PacketId, Sighting]] = []  # also before it is known whose epoch it is
    verdicts: list[VerdictRecord] = []
    kinds = {Kind.PACKET, Kind.VERDICT} if has_verdicts else {Kind.PACKET}
    for record in capture.records(kinds, start_ns=start_ns, end_ns=end_ns):
        if isinstance(record, VerdictRecord):
            verdicts.append(record)
        elif isinstance(record, PacketRecord) and (here := _seen(record)) is not None:
            mesh, sighting = here
            if record.node in found and not sighting.mesh:
                _note(found[record.node], mesh, sighting)
            if mesh.fragments:
                seen.append((_id(mesh), sighting))
    _sort_out(list(found.values()), seen, verdicts)
    return found


def _sort_out(found: list[Evidence], seen: list[tuple[PacketId, Sighting]], verdicts: Iterable[VerdictRecord]) -> None:
    """Give each sender what was seen of its datagrams, and what was decided on them."""
    owners = {epoch: evidence for evidence in found for epoch in evidence.epochs}
    carriers: dict[tuple[Interface, int], list[Evidence]] = {}
    for packet, sighting in seen:
        owner = owners.get(packet[0])
        if owner is None:
            continue
        owner.sightings[packet].append(sighting)
        if sighting.is_outbound:
            of_frame = carriers.setdefault((sighting.interface, sighting.crc32), [])
            if owner not in of_frame:
                of_frame.append(owner)
    for verdict in verdicts:
        key = (verdict.sender, verdict.crc32)
        for owner in carriers.get(key, ()):
            owner.note_decision(key, _decision(verdict))


def _seen(record: PacketRecord) -> tuple[Dissection, Sighting] | None:
    if record.linktype != LINKTYPE_ETHERNET:
        return None
    mesh_name, frame = peel(record.frame)
    datagram = udp_of(frame)
    mesh = mesh_of(datagram) if datagram is not None else None
    if mesh is None:
        return None
    outer = record.frame
    return mesh, Sighting(
        record.t_ns,
        (record.node, record.interface),
        record.direction is Direction.OUTBOUND,
        record.original_length,
        record.crc32,
        bytes(outer[6:12]),
        bytes(outer[:6]),
        mesh_name,
    )


def _note(found: Evidence, mesh: Dissection, sighting: Sighting) -> None:
    """Take what a datagram at an interface of the sender itself tells."""
    if sighting.is_outbound and not mesh.is_bridged:
        found.epochs.add(mesh.epoch)
        for piece in mesh.fragments:
            header = traffic_in(piece)
            found.departures.append(
                Departure(
                    sighting.t_ns,
                    found.node,
                    _id(mesh),
                    piece.message_id,
                    piece.fragment_index,
                    piece.fragment_count,
                    piece.priority,
                    len(piece.payload),
                    0 if mesh.is_broadcast else mesh.destination_tag,
                    piece.topic,
                    (header.stream, header.seq) if header else None,
                )
            )
    elif not sighting.is_outbound:
        found.acks += [AckHeard(sighting.t_ns, mesh.epoch, ack.ranges) for ack in mesh.acks]
        found.backlogs += [BacklogHeard(sighting.t_ns, mesh.epoch, priority) for priority in mesh.backlogs]


def _id(mesh: Dissection) -> PacketId:
    return mesh.epoch, mesh.packet_number, 0 if mesh.is_broadcast else mesh.destination_tag


def _decision(record: VerdictRecord) -> Decision:
    return Decision(record.t_ns, record.receiver, record.verdict, record.departs_ns, record.attempts, record.rssi_dbm)
