"""Frames from members: opened, told apart, handed to whom they concern. What cannot be believed is counted and ends."""

from __future__ import annotations

from wnet.core import wire, wire_control
from wnet.core.context import Context
from wnet.core.control import Control
from wnet.core.events import Count, Drop
from wnet.core.flooding import Floods
from wnet.core.forwarding import Forwarder
from wnet.core.link import Link
from wnet.core.links import LinkTable
from wnet.core.members import Reception
from wnet.core.neighbours import Neighbours
from wnet.core.outbox import Outbox
from wnet.core.retries import Retries
from wnet.core.seal import Seal

#: What a node sends to one neighbour alone, at the rate that this link carries; all else may be at the slowest.
_AT_LINK_RATE = frozenset({wire.PROBE, wire.UNICAST, wire.ROUTED})


class Receiver:
    """What one node makes of the frames that it receives."""

    def __init__(
        self,
        context: Context,
        seal: Seal | None,
        links: LinkTable,
        floods: Floods,
        neighbours: Neighbours,
        outbox: Outbox,
        retries: Retries,
        forwarder: Forwarder,
        control: Control,
    ) -> None:
        self._noise_dbm = context.config.noise_dbm
        self._members = context.members
        self._graph = context.graph
        self._journal = context.journal
        self._seal = seal
        self._links = links
        self._floods = floods
        self._neighbours = neighbours
        self._outbox = outbox
        self._retries = retries
        self._forwarder = forwarder
        self._control = control

    def receive(self, member: int, frame: bytes, *, reception: Reception | None, now: float) -> None:
        """Take a frame, from its destination address on. Never raises."""
        if len(frame) <= wire.ETHERNET_BYTES or frame[12:14] != wire.ETHERTYPE:
            self._journal.count(Drop.TOO_SHORT if len(frame) <= wire.ETHERNET_BYTES else Drop.OTHER_TYPE)
            return
        own_mac = self._members[member].mac
        destination, source = frame[:6], frame[6:12]
        if source == own_mac or (destination != own_mac and not destination[0] & 1):
            self._journal.count(Count.OWN if source == own_mac else Drop.NOT_LISTED)
            return
        body = self._seal.open(frame) if self._seal is not None else frame[wire.ETHERNET_BYTES :]
        if isinstance(body, Drop):
            self._journal.count(body)
            return
        link = self._links.find(member, source)
        if body[:1] == wire.AGGREGATE_HEAD:
            bodies = wire.split(body)
            if isinstance(bodies, Drop):
                self._journal.count(bodies)
                return
        else:
            bodies = [body]
        for part in bodies:
            self._take(member, source, link, part, reception, now)

    def _take(
        self, member: int, source: bytes, link: Link | None, body: bytes, reception: Reception | None, now: float
    ) -> None:
        kind = body[0] if body else 0
        if kind == wire.HELLO:
            self._take_hello(member, source, body, reception, now)
        elif kind == wire.SEALED:
            self._journal.count(Drop.UNKNOWN_KEY)
        elif kind not in wire.KINDS or kind == wire.AGGREGATE:
            self._journal.count(Drop.VERSION)
        elif link is None or not (link.is_listed or self._seal is None):
            self._journal.count(Drop.STRANGER)
        elif kind == wire.ACK:
            self._take_ack(link, body, reception, now)
        else:
            self._take_data(link, body, reception, now)

    def _take_hello(self, member: int, source: bytes, body: bytes, reception: Reception | None, now: float) -> None:
        hello = wire_control.decode_hello(body)
        if isinstance(hello, Drop):
            self._journal.count(hello)
            return
        link = self._neighbours.take_hello(member, source, hello, reception=reception, now=now)
        if link is not None and link.is_usable:
            self._control.compare(link, now=now)

    def _take_ack(self, link: Link, body: bytes, reception: Reception | None, now: float) -> None:
        ack = wire_control.decode_ack(body)
        if isinstance(ack, Drop):
            self._journal.count(ack)
            return
        link.hear(reception, self._noise_dbm, now=now)
        self._retries.acknowledge(link, ack, now=now)

    def _take_data(self, link: Link, body: bytes, reception: Reception | None, now: float) -> None:
        data = wire.decode(body)
        if isinstance(data, Drop):
            self._journal.count(data)
            return
        link.hear(reception, self._noise_dbm, now=now)
        if data.kind in _AT_LINK_RATE:
            link.note_rate(reception)
        own_mac = self._members[link.member].mac
        place, sequence = 0, data.sequence
        if data.hops or data.kind in (wire.FLOOD, wire.TC, wire.MULTICAST):
            found = ((place, hop.sequence) for place, hop in enumerate(data.hops) if hop.peer_mac == own_mac)
            place, sequence = next(found, (0, -1))
        if sequence >= 0:
            ahead = link.data_window.take(sequence)
            if ahead >= 0:
                link.loss.count(ahead)
            if data.is_ack_wanted:
                self._outbox.owe(link, data.attempt, place=place, now=now)
        if data.kind == wire.TC:
            self._take_tc(link, data, own_mac, now)
        elif data.kind != wire.PROBE:
            link.note_traffic(now=now)
            self._forwarder.receive(data, link, own_mac, now=now)

    def _take_tc(self, link: Link, data: wire.Data, own_mac: bytes, now: float) -> None:
        node = wire.source_of(data.tail)
        epoch, sequence = wire.origin_of(data.tail)
        if node == self._graph.own.mac:
            self._journal.count(Count.OWN)
            if epoch != self._graph.own.epoch:
                self._control.contradict(epoch, sequence, link, now=now)
            return
        if self._graph.is_former(node, epoch):
            self._journal.count(Count.DUPLICATE)
            return
        is_listed = any(hop.peer_mac == own_mac for hop in data.hops)
        if not self._forwarder.is_new_tc(data.tail) or not self._graph.is_newer(node, epoch, sequence):
            self._journal.count(Count.DUPLICATE)
            if is_listed:
                self._relay_tc(node, link, data, now)
            return
        topology = wire_control.decode_tc(wire.inner_of(data.tail))
        if isinstance(topology, Drop):
            self._journal.count(topology)
            return
        age_s = data.sequence * wire.AGE_UNIT_S
        is_relay = is_listed or (
            self._floods.is_gap(link, now=now) and self._control.may_relay_unasked(len(data.tail), now=now)
        )
        if self._graph.update(topology, epoch, sequence, data.tail, age_s=age_s, now=now) and is_relay:
            self._relay_tc(node, link, data, now)

    def _relay_tc(self, mac: bytes, link: Link, data: wire.Data, now: float) -> None:
        """Relay a TC, once. Also when only a later copy asks for it: while links come and go, the relays that the
        sender of the first one chose may not reach all that this node does."""
        node = self._graph.nodes.get(mac)
        if node is not None and node.tail == data.tail and not node.is_relayed:
            node.is_relayed = True
            self._control.account(len(data.tail), now=now)
            self._forwarder.relay_flood(data, link, now=now)
