"""The way of a frame of data through this node: from the mesh interface, from a member, to either.

Paths belong to :mod:`wnet.core.routes`; here every frame gets its next hops, once per destination. A frame that was
here before is dropped, whatever the reason for its return: so no frame is forwarded twice by one node, and none is
delivered twice, however much the nodes' views of the topology differ.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from wnet.core import groups, wire
from wnet.core.arp import Arp
from wnet.core.context import Context
from wnet.core.events import Count, Drop
from wnet.core.flooding import Floods
from wnet.core.groups import Groups
from wnet.core.link import Link
from wnet.core.links import LinkTable
from wnet.core.next_hops import NextHops
from wnet.core.outbox import Outbox
from wnet.core.routes import Routes
from wnet.core.seen import Seen
from wnet.core.transmissions import Entry, Packet, Transmission
from wnet.core.urgency import urgency_of, urgency_of_dscp

_MOST_REROUTES = 2
_MAX_DELIVERED = 4096


class Forwarder:
    """One node's data path."""

    def __init__(
        self,
        context: Context,
        links: LinkTable,
        routes: Routes,
        floods: Floods,
        outbox: Outbox,
        own_groups: Groups,
        arp: Arp,
    ) -> None:
        self._config = context.config
        self._graph = context.graph
        self._mac = context.graph.own.mac
        self._epoch = context.graph.own.epoch
        self._links = links
        self._routes = routes
        self._floods = floods
        self._outbox = outbox
        self._journal = context.journal
        self._groups = own_groups
        self._arp = arp
        self._sequence = context.rng.getrandbits(32)
        self._seen = Seen()
        self._next_hops = NextHops(routes, links, context.journal)
        redundant = context.config.redundant_dscp
        self._redundant_urgency = -1 if redundant is None else urgency_of_dscp(redundant)
        self.delivered: deque[bytes] = deque(maxlen=_MAX_DELIVERED)

    def next_sequence(self) -> int:
        """Return the number of this node's next frame."""
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        return self._sequence

    # -- from the mesh interface -------------------------------------------------------------------------------------

    def originate(self, inner: bytes, *, now: float) -> None:
        """Send a frame of this node; ARP that can be answered here is."""
        destination = inner[:6]
        if destination[0] & 1:
            answer = self._arp.read(inner, self._graph.owners) if inner[12:14] == b"\x08\x06" else None
            if answer is not None:
                self._journal.count(Count.ARP_ANSWERED)
                self.delivered.append(answer)
                return
        self._journal.count(Count.ORIGINATED)
        tail = wire.tail_of(self._epoch, self.next_sequence(), inner)
        packet = Packet(wire.UNICAST, tail, self._config.hop_limit, urgency_of(inner), None)
        if not destination[0] & 1:
            self._send_second(packet, now)
            self._forward(packet, (destination,), now)
        elif groups.is_ip_group(destination) and destination not in groups.ALL_HOSTS:
            listeners = self._routes.listeners(destination)
            if listeners:
                self._forward(packet, listeners, now)
            else:
                self._drop(packet, Drop.NO_MEMBER, now)
        else:
            packet.kind = wire.FLOOD
            if not self._floods.send(packet, is_retried=True, now=now):
                self._drop(packet, Drop.NO_ROUTE, now)

    def _send_second(self, packet: Packet, now: float) -> None:
        """Send an urgent frame along a second path that shares no relay with the first."""
        if packet.urgency > self._redundant_urgency:
            return
        path = self._routes.disjoint_path(packet.destination)
        if path:
            self._journal.count(Count.REDUNDANT)
            second = Packet(wire.ROUTED, packet.tail, packet.hop_limit, packet.urgency, None, route=path)
            self._send_routed(second, now)

    # -- from a member -----------------------------------------------------------------------------------------------

    def receive(self, data: wire.Data, link: Link, own_member_mac: bytes, *, now: float) -> None:
        """Take a frame of data, or a share of it, from a neighbour."""
        tail = data.tail
        if wire.source_of(tail) == self._mac:
            self._journal.count(Count.OWN)
        elif data.kind == wire.UNICAST:
            self._take(data, link, (wire.destination_of(tail),), now)
        elif data.kind == wire.MULTICAST:
            hop = next((hop for hop in data.hops if hop.peer_mac == own_member_mac), None)
            if hop is None:
                self._journal.count(Drop.NOT_LISTED)
            else:
                self._take(data, link, hop.destinations, now)
        elif data.kind == wire.ROUTED:
            self._take_routed(data, link, now)
        else:
            self._take_flood(data, link, own_member_mac, now)

    def _take(self, data: wire.Data, link: Link, destinations: Sequence[bytes], now: float) -> None:
        key = wire.key_of(data.tail)
        fresh = [node for node in destinations if self._seen.add(key + node)]
        if not fresh:
            self._journal.count(Count.DUPLICATE)
            return
        if self._mac in fresh:
            fresh.remove(self._mac)
            self._deliver(data.tail)
        if fresh:
            self._relay(data, link, fresh, now)

    def _relay(self, data: wire.Data, link: Link, destinations: Sequence[bytes], now: float) -> None:
        packet = Packet(wire.UNICAST, data.tail, data.hop_limit - 1, data.urgency, link.neighbour)
        if packet.hop_limit <= 0:
            self._drop(packet, Drop.HOP_LIMIT, now)
            return
        self._journal.counts[Count.RELAYED] += 1
        self._forward(packet, destinations, now)

    def _take_routed(self, data: wire.Data, link: Link, now: float) -> None:
        key = wire.key_of(data.tail)
        if not data.route or data.route[0] != self._mac:
            self._journal.count(Drop.NOT_LISTED)
        elif not self._seen.add(key + wire.destination_of(data.tail)):
            self._journal.count(Count.DUPLICATE)
        elif len(data.route) == 1:
            self._deliver(data.tail)
        else:
            packet = Packet(
                wire.ROUTED, data.tail, data.hop_limit - 1, data.urgency, link.neighbour, route=data.route[1:]
            )
            self._journal.count(Count.RELAYED)
            self._send_routed(packet, now)

    def _take_flood(self, data: wire.Data, link: Link, own_member_mac: bytes, now: float) -> None:
        if not self._seen.add(wire.key_of(data.tail)):
            self._journal.count(Count.DUPLICATE)
            return
        self._deliver(data.tail)
        if any(hop.peer_mac == own_member_mac for hop in data.hops) or self._floods.is_gap(link, now=now):
            self.relay_flood(data, link, now=now)

    def relay_flood(self, data: wire.Data, link: Link, *, now: float) -> None:
        """Send a flood, or a TC, on to all neighbours."""
        packet = Packet(data.kind, data.tail, data.hop_limit - 1, data.urgency, link.neighbour)
        packet.age_s = data.sequence * wire.AGE_UNIT_S
        if packet.hop_limit <= 0:
            self._drop(packet, Drop.HOP_LIMIT, now)
            return
        if data.kind == wire.FLOOD:
            self._journal.count(Count.RELAYED)
        self._floods.send(packet, is_retried=True, now=now)

    def is_new_tc(self, tail: bytes) -> bool:
        """Whether a TC was not here yet."""
        return self._seen.add(wire.key_of(tail))

    def _deliver(self, tail: bytes) -> None:
        self._journal.counts[Count.DELIVERED] += 1
        self.delivered.append(wire.inner_of(tail))

    # -- to the next hops --------------------------------------------------------------------------------------------

    def _forward(self, packet: Packet, destinations: Sequence[bytes], now: float) -> None:
        if len(destinations) == 1:
            link = self._next_link(packet, destinations[0], now)
            if link is not None:
                self._submit(packet, link.member, {link: list(destinations)}, now)
            return
        by_member: dict[int, dict[Link, list[bytes]]] = {}
        for destination in destinations:
            link = self._next_link(packet, destination, now)
            if link is not None:
                by_member.setdefault(link.member, {}).setdefault(link, []).append(destination)
        for member, shares in by_member.items():
            self._submit(packet, member, shares, now)

    def _submit(self, packet: Packet, member: int, shares: dict[Link, list[bytes]], now: float) -> None:
        """Queue a packet for next hops on one member, in as many frames as their lists need."""
        limit = self._outbox.limit_bytes(member) - wire.HEADER_BYTES - len(packet.tail) + wire.ORIGIN_BYTES
        if limit < 0:
            self._drop(packet, Drop.OVERSIZED, now)
            return
        if len(shares) == 1:
            (link, destinations) = next(iter(shares.items()))
            if destinations == [packet.destination]:
                self._submit_entries(packet, member, [Entry(link, tuple(destinations))], now)
                return
        entries: list[Entry] = []
        if wire.forward_list_bytes([1]) > limit:
            self._drop(packet, Drop.OVERSIZED, now)
            return
        for link, destinations in shares.items():
            for entry in _pieces(link, destinations, limit):
                if _list_bytes([*entries, entry]) > limit:
                    self._submit_entries(packet, member, entries, now)
                    entries = []
                entries.append(entry)
        self._submit_entries(packet, member, entries, now)

    def _submit_entries(self, packet: Packet, member: int, entries: list[Entry], now: float) -> None:
        tries = self._config.tries
        for entry in entries:
            entry.link.note_sending(now=now)
        self._outbox.submit(Transmission(packet, member, entries, tries, is_group=len(entries) > 1), now=now)

    def _send_routed(self, packet: Packet, now: float) -> None:
        link = self._links.best(packet.route[0])
        if link is None or packet.hop_limit <= 0:
            self._drop(packet, Drop.NO_ROUTE, now)
            return
        length = wire.HEADER_BYTES + len(packet.tail) - wire.ORIGIN_BYTES + 1 + 6 * len(packet.route)
        if length > self._outbox.limit_bytes(link.member):
            self._drop(packet, Drop.OVERSIZED, now)
            return
        self._submit_entries(packet, link.member, [Entry(link, (packet.destination,))], now)

    def _next_link(self, packet: Packet, destination: bytes, now: float) -> Link | None:
        found = self._next_hops.choose(packet, destination, but=None, now=now)
        if isinstance(found, Drop):
            self._drop(packet, found, now)
            return None
        return found

    def reroute(self, packet: Packet, entry: Entry, *, now: float) -> bool:
        """Send by another next hop what one has not acknowledged; False if there is none."""
        if packet.kind not in (wire.UNICAST, wire.MULTICAST) or packet.reroutes >= _MOST_REROUTES:
            return False
        found: dict[bytes, Link] = {}
        for node in entry.destinations:
            link = self._next_hops.choose(packet, node, but=entry.link, now=now)
            if isinstance(link, Drop) or link.is_suspect:
                return False
            found[node] = link
        packet.reroutes += 1
        for node, link in found.items():
            self._submit(packet, link.member, {link: [node]}, now)
        return True

    def resubmit(self, packet: Packet, entry: Entry, *, now: float) -> None:
        """Send by what the graph offers now what was meant for a link that is gone."""
        if packet.kind in (wire.UNICAST, wire.MULTICAST) and not self.reroute(packet, entry, now=now):
            self._drop(packet, Drop.NOT_ACKNOWLEDGED, now)

    def _drop(self, packet: Packet, reason: Drop, now: float) -> None:
        size_bytes = len(packet.tail) - wire.ORIGIN_BYTES
        self._journal.drop(reason, packet.source, packet.destination, size_bytes, now=now)


def _list_bytes(entries: Sequence[Entry]) -> int:
    return wire.forward_list_bytes([len(entry.destinations) for entry in entries])


def _pieces(link: Link, destinations: Sequence[bytes], limit: int) -> list[Entry]:
    """Return entries for one next hop, each of which fits into a list of its own."""
    most = max((limit - wire.forward_list_bytes([0])) // 6, 1)
    return [Entry(link, tuple(destinations[i : i + most])) for i in range(0, len(destinations), most)]
