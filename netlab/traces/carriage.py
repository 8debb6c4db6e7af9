"""The way of one datagram from node to node: over which relays it came, how long each hop took, where it ended."""

from __future__ import annotations

from dataclasses import dataclass

from netlab.medium.verdicts import Verdict
from netlab.traces.evidence import Decision, Evidence, PacketId, Sighting
from netlab.traces.model import Interface, Trace

ARRIVED = (Verdict.DELIVERED, Verdict.REORDERED, Verdict.DUPLICATED)
_MOST_HOPS = 255
_SAME_HANDLING_NS = 1_000_000_000  # between a frame's arrival at a relay and its departure


@dataclass(frozen=True, slots=True)
class Hop:
    """One frame from one interface towards another. ``arrived_ns`` is None if it did not arrive there.

    ``attempts`` are the transmissions of an 802.11 radio, 0 elsewhere. ``verdict`` and ``rssi_dbm`` are None where the
    medium tells no decisions.
    """

    sender: Interface
    receiver: Interface
    left_ns: int
    arrived_ns: int | None
    frame_bytes: int
    verdict: Verdict | None = None
    attempts: int = 0
    rssi_dbm: int | None = None


@dataclass(frozen=True, slots=True)
class Carriage:
    """What became of one datagram on its way to one node.

    Attributes:
        hops: In order; of a datagram that did not arrive, those frames whose fate at the destination is known, or where
            none is, at whoever was to get them first.
        arrived_ns: At the destination, None if it did not get there.
    """

    hops: tuple[Hop, ...]
    arrived_ns: int | None

    @property
    def relays(self) -> tuple[str, ...]:
        """The nodes between."""
        return tuple(hop.sender[0] for hop in self.hops[1:]) if self.arrived_ns is not None else ()


def carriage(trace: Trace, evidence: Evidence, packet: PacketId, destination: str, *, left_ns: int) -> Carriage:
    """Follow a datagram that left at ``left_ns`` to its destination."""
    seen = [sighting for sighting in evidence.sightings.get(packet, []) if sighting.t_ns >= left_ns]
    inside = [s for s in seen if not s.is_outbound and s.interface[0] == destination]
    if not inside:
        return Carriage(_towards(evidence, seen, destination), None)
    plain = [sighting for sighting in inside if not sighting.mesh] or inside
    wire = [sighting for sighting in inside if sighting.mesh] or plain  # as the member of a mesh saw it
    return Carriage(tuple(_back(trace, evidence, seen, min(wire, key=_when))), plain[0].t_ns)


def _when(sighting: Sighting) -> int:
    return sighting.t_ns


def _back(trace: Trace, evidence: Evidence, seen: list[Sighting], arrival: Sighting) -> list[Hop]:
    """From an arrival to the sender, each time by the frame that brought it."""
    hops: list[Hop] = []
    here: Sighting | None = arrival
    while here is not None and len(hops) < _MOST_HOPS:
        sent = _sent_by(trace, seen, here)
        if sent is None:
            break
        hops.append(_hop(evidence, sent, here.interface, here.t_ns))
        if sent.interface[0] == evidence.node:
            break
        before = [s for s in seen if s.interface[0] == sent.interface[0] and not s.is_outbound and s.t_ns <= sent.t_ns]
        on_air = [s for s in before if s.mesh == sent.mesh] or before
        here = min(on_air, key=_when, default=None)
    return hops[::-1]


def _sent_by(trace: Trace, seen: list[Sighting], arrival: Sighting) -> Sighting | None:
    """The frame that arrived, as it left: same mesh, sent by whose address it bears, the last one before."""
    sender = trace.macs.get(arrival.mac_from)
    left = [s for s in seen if s.is_outbound and s.t_ns <= arrival.t_ns and s.interface[0] != arrival.interface[0]]
    same = [s for s in left if s.mesh == arrival.mesh] or left
    theirs = [s for s in same if s.interface == sender] or [s for s in same if s.mac_from == arrival.mac_from] or same
    exact = [s for s in theirs if s.crc32 == arrival.crc32] or theirs
    return max(exact, key=_when, default=None)


def _hop(evidence: Evidence, sent: Sighting, receiver: Interface, arrived_ns: int | None) -> Hop:
    decisions = [decision for decision in evidence.decisions(sent) if decision.receiver == receiver]
    return _decided(sent, receiver, arrived_ns, decisions[0] if decisions else None)


def _decided(sent: Sighting, receiver: Interface, arrived_ns: int | None, decision: Decision | None) -> Hop:
    verdict, attempts, rssi_dbm = (
        (decision.verdict, decision.attempts, decision.rssi_dbm) if decision else (None, 0, None)
    )
    return Hop(sent.interface, receiver, sent.t_ns, arrived_ns, sent.frame_bytes, verdict, attempts, rssi_dbm)


def _towards(evidence: Evidence, seen: list[Sighting], destination: str) -> tuple[Hop, ...]:
    """Where a datagram that did not arrive was lost."""
    hops = []
    for sent in (sighting for sighting in seen if sighting.is_outbound):
        hops += [_decided(sent, decision.receiver, None, decision) for decision in evidence.decisions(sent)]
    final = [hop for hop in hops if hop.receiver[0] == destination]
    return tuple(final or [hop for hop in hops if hop.verdict not in ARRIVED])
