"""A frame of data on its way over one hop: to one next hop or, on one radio, to several at once. Values with state."""

from __future__ import annotations

from dataclasses import dataclass

from wnet.core import wire
from wnet.core.link import Link


@dataclass(slots=True)
class Packet:
    """A frame of data in this node. ``via``: the node that it came from, None for this node's own.

    ``hop_limit``: what the next transmission carries. ``route``: the nodes to pass, of ROUTED only.
    """

    kind: int
    tail: bytes
    hop_limit: int
    urgency: int
    via: bytes | None
    route: tuple[bytes, ...] = ()
    age_s: float = 0.0
    """Of a TC: since its origin sent it."""
    reroutes: int = 0
    """How often another next hop was tried."""

    @property
    def destination(self) -> bytes:
        """The destination address of the frame inside."""
        return wire.destination_of(self.tail)

    @property
    def source(self) -> bytes:
        """The node that it is from."""
        return wire.source_of(self.tail)


@dataclass(slots=True)
class Entry:
    """One next hop and what it shall forward to. ``sequence``: on its link, of the last try; every try has its own, so
    that gaps tell the real loss, and ``earlier`` are those of the others."""

    link: Link
    destinations: tuple[bytes, ...]
    sequence: int = -1
    earlier: tuple[int, ...] = ()


@dataclass(slots=True, eq=False)
class Transmission:
    """A packet on one member. ``entries``: the next hops that have not acknowledged it.

    ``is_group``: it is sent to a group address, once for all, and may have no entries at all. ``attempts``: times sent.
    """

    packet: Packet
    member: int
    entries: list[Entry]
    tries: int
    is_group: bool = False
    attempts: int = 0
    sent_at: float = 0.0
    queued_at: float = 0.0

    @property
    def is_done(self) -> bool:
        """Whether nothing is awaited any more."""
        return not self.entries

    def body(self, attempt: int, is_ack_wanted: bool) -> bytes:
        """Return its bytes; the sequences of the entries have to be set."""
        packet, entries = self.packet, self.entries
        kind, sequence, listing = packet.kind, 0, b""
        if kind in (wire.FLOOD, wire.TC):
            sequence = min(int(packet.age_s / wire.AGE_UNIT_S), 0xFFFF)
            listing = wire.relay_list([wire.Hop(e.link.peer_mac, e.sequence, ()) for e in entries])
        elif kind == wire.ROUTED:
            sequence, listing = entries[0].sequence, wire.route_list(packet.route)
        elif kind == wire.PROBE or (len(entries) == 1 and entries[0].destinations == (packet.destination,)):
            kind = kind if kind == wire.PROBE else wire.UNICAST
            sequence = entries[0].sequence
        else:
            hops = [wire.Hop(e.link.peer_mac, e.sequence, e.destinations) for e in entries]
            kind, listing = wire.MULTICAST, wire.forward_list(hops)
        return wire.encode(
            kind,
            packet.tail,
            is_ack_wanted=is_ack_wanted,
            attempt=attempt,
            hop_limit=packet.hop_limit,
            urgency=packet.urgency,
            sequence=sequence,
            listing=listing,
        )
