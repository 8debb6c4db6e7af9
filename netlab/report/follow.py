"""Follows a message from interface to interface through the packets of its time. Pure.

A packet is followed through a mesh by the frame inside: every hop's frame has bytes of its own, what they carry is the
same. Of a packet that many nodes passed on only the way is kept on which it first reached its destination.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

from netlab.capture import batman, flood
from netlab.capture.decoders import ethertype, mesh_of, udp_of
from netlab.capture.records import PacketRecord, VerdictRecord
from netlab.capture.schemas import Direction
from netlab.medium.verdicts import Verdict
from netlab.report.lane import Cargo, Flight, Lane, fragments_of
from netlab.traces.messages import MessageLife
from netlab.traces.model import Fragment, Interface, Trace
from udp_mesh.core.packets import Dissection
from udp_mesh.core.wire import tag_of

_ARRIVED = (Verdict.DELIVERED, Verdict.CORRUPTED, Verdict.DUPLICATED, Verdict.REORDERED)


@dataclass(slots=True)
class _Sighting:
    """A frame at an interface: the packet inside is known by its checksum, the frame by its own."""

    t_ns: int
    interface: Interface
    is_outbound: bool
    frame: int
    packet: int


@dataclass(slots=True)
class _Packets:
    """What was seen of the message's packets and of those that acknowledge them."""

    sightings: list[_Sighting] = field(default_factory=list)
    cargo: dict[int, tuple[Cargo, tuple[int, ...]]] = field(default_factory=dict)  # by packet
    lost: dict[tuple[int, Interface], VerdictRecord] = field(default_factory=dict)  # by frame and sender


def build_lane(
    trace: Trace, life: MessageLife, packets: Iterable[PacketRecord], verdicts: Iterable[VerdictRecord]
) -> Lane:
    """Follow a message through the packets and verdicts of its :func:`window_ns`, which come in the order of time."""
    fragments = fragments_of(trace, life)
    seen = _Packets()
    _see(seen, packets, life, fragments)
    for verdict in verdicts:
        if verdict.verdict not in _ARRIVED:
            key = (verdict.crc32, verdict.sender)
            if key not in seen.lost or verdict.receiver[0] == life.stream.destination:
                seen.lost[key] = verdict
    flights = sorted(_flights(seen, life), key=lambda flight: flight.sent_ns)
    return Lane(life, _interfaces(flights, life), tuple(flights), not fragments and life.delivery is not None)


def _see(seen: _Packets, packets: Iterable[PacketRecord], life: MessageLife, fragments: list[Fragment]) -> None:
    source, destination = life.stream.source, life.stream.destination
    ids = {(fragment.epoch, fragment.message_id) for fragment in fragments}
    copies_ns = {fragment.t_ns for fragment in fragments if fragment.is_copy}
    sent: set[int] = set()
    unacknowledged: set[int] = set()
    tags = {tag_of(epoch) for epoch, _ in ids}
    for record in packets:
        inner = _innermost(record.frame)
        datagram = udp_of(inner, record.linktype)
        mesh = mesh_of(datagram) if datagram is not None else None
        if mesh is None:
            continue
        packet = record.crc32 if inner is record.frame else zlib.crc32(inner)
        outbound = record.direction is Direction.OUTBOUND
        if outbound and packet not in seen.cargo:
            pieces = tuple(p.fragment_index for p in mesh.fragments if (mesh.epoch, p.message_id) in ids)
            if pieces and record.node == source:
                again = Cargo.COPY if record.t_ns in copies_ns else Cargo.AGAIN
                seen.cargo[packet] = (again if sent & set(pieces) else Cargo.FIRST, pieces)
                sent.update(pieces)
                unacknowledged.add(mesh.packet_number)
            elif record.node == destination and mesh.destination_tag in tags and (news := _news(mesh, unacknowledged)):
                seen.cargo[packet] = (Cargo.ACK, ())
                unacknowledged -= news
        if packet in seen.cargo:
            interface = (record.node, record.interface)
            seen.sightings.append(_Sighting(record.t_ns, interface, outbound, record.crc32, packet))


def _innermost(frame: bytes) -> bytes:
    """The Ethernet frame inside a mesh's frame, or the frame itself."""
    kind, start = ethertype(frame)
    if kind == batman.ETHERTYPE:
        at = batman.inner_offset(frame, start)
    elif kind == flood.ETHERTYPE:
        at = flood.inner_offset(frame)
    else:
        return frame
    return frame[at:] if at is not None else frame


def _news(mesh: Dissection, numbers: set[int]) -> set[int]:
    ranges = [pair for ack in mesh.acks for pair in ack.ranges]
    return {number for number in numbers if any(first <= number <= last for first, last in ranges)}


def _flights(seen: _Packets, life: MessageLife) -> Iterator[Flight]:
    by_packet: dict[int, list[_Sighting]] = {}
    for sighting in seen.sightings:
        by_packet.setdefault(sighting.packet, []).append(sighting)
    for packet, sightings in by_packet.items():
        cargo, pieces = seen.cargo[packet]
        if any(sighting.frame != packet for sighting in sightings):  # the hops tell more than the mesh's own interfaces
            sightings = [sighting for sighting in sightings if sighting.frame != packet]
        target = life.stream.source if cargo is Cargo.ACK else life.stream.destination
        hops = _way(sightings, target)
        blank = Flight(cargo, 0, ("", ""), ("", ""), None, "", pieces)
        if hops:
            for out, arrival in hops:
                yield replace(
                    blank,
                    sent_ns=out.t_ns,
                    sender=out.interface,
                    receiver=arrival.interface,
                    arrived_ns=arrival.t_ns,
                )
        else:
            yield from _lost(seen, sightings, blank, target)


def _way(sightings: list[_Sighting], target: str) -> list[tuple[_Sighting, _Sighting]]:
    """The hops on which a packet first reached a node, first one first; empty if it never did."""
    hops: list[tuple[_Sighting, _Sighting]] = []
    node, before_ns = target, 1 << 63
    while True:
        arrivals = [s for s in sightings if not s.is_outbound and s.interface[0] == node and s.t_ns <= before_ns]
        if not arrivals or len(hops) > len(sightings):
            break
        arrival = arrivals[0]
        sent = [s for s in sightings if s.is_outbound and s.frame == arrival.frame and s.interface[0] != node]
        sent = [s for s in sent if s.t_ns <= arrival.t_ns]
        if not sent:
            break
        hops.insert(0, (sent[-1], arrival))
        node, before_ns = sent[-1].interface[0], sent[-1].t_ns
    return hops


def _lost(seen: _Packets, sightings: list[_Sighting], blank: Flight, target: str) -> Iterator[Flight]:
    """A packet that never reached its destination: as far as it came, and what became of it there."""
    last = next((sighting for sighting in reversed(sightings) if sighting.is_outbound), None)
    if last is None:
        return
    verdict = seen.lost.get((last.frame, last.interface))
    receiver = verdict.receiver if verdict is not None else (target, "")
    why = verdict.verdict.name.lower().replace("_", " ") if verdict is not None else "not seen again"
    yield replace(blank, sent_ns=last.t_ns, sender=last.interface, receiver=receiver, lost=why)


def _interfaces(flights: Iterable[Flight], life: MessageLife) -> tuple[Interface, ...]:
    """The source's, those on the way in the order of their first packet, the destination's."""
    ordered: dict[Interface, None] = {}
    for flight in flights:
        if flight.cargo is not Cargo.ACK:
            ordered.setdefault(flight.sender)
            if flight.receiver[1]:
                ordered.setdefault(flight.receiver)
    for flight in flights:
        for end in (flight.sender, flight.receiver):
            if end[1]:
                ordered.setdefault(end)
    rank = {life.stream.source: 0, life.stream.destination: 2}
    return tuple(sorted(ordered, key=lambda interface: rank.get(interface[0], 1)))
