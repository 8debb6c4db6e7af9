"""One node's mesh behind one object: frames, timers and events in, frames and events out. No clock, no socket.

Here the parts are put together and called in turn; what they do belongs to their modules.
"""

from __future__ import annotations

import random
from collections.abc import Sequence

from wnet.config import MeshConfig
from wnet.core import groups, reports, wire, wire_control
from wnet.core.arp import Arp
from wnet.core.context import Context
from wnet.core.control import Control
from wnet.core.events import Count, Drop, Event, LinkDownReason
from wnet.core.flooding import Floods
from wnet.core.forwarding import Forwarder
from wnet.core.groups import Groups
from wnet.core.journal import Journal
from wnet.core.link import Link
from wnet.core.links import LinkTable
from wnet.core.members import Member, Outgoing, Reception
from wnet.core.neighbours import Neighbours
from wnet.core.outbox import CONTROL, Outbox
from wnet.core.receiver import Receiver
from wnet.core.retries import Retries
from wnet.core.routes import Routes
from wnet.core.seal import Seal
from wnet.core.snapshot import LinkState, Snapshot
from wnet.core.topology import TopologyGraph
from wnet.core.transmissions import Entry, Packet, Transmission
from wnet.core.wire_control import NodeInfo

__all__ = ["Count", "Drop", "Member", "Mesh", "Outgoing", "Reception"]

MESH_MTU_BYTES = 1500
_LEAST_PROBE_TRIES = 3
_PROBE_AND_ACK_BYTES = 2 * wire.ETHERNET_BYTES + wire.HEAD_BYTES + wire_control.ACK_BYTES


class Mesh:
    """A node of the mesh.

    The owner calls :meth:`receive`, :meth:`originate` and, when :meth:`next_timer` has come, :meth:`handle_timer`;
    after each (or after a batch of them) it sends what :meth:`frames_to_send` gives, hands :meth:`take_delivered` to
    the mesh interface and looks at :meth:`next_event`.
    """

    def __init__(
        self,
        config: MeshConfig,
        mac: bytes,
        members: Sequence[Member],
        *,
        epoch: int,
        rng: random.Random,
        now: float,
    ) -> None:
        """Start with nothing known.

        Args:
            config: The settings.
            mac: The mesh interface's address, which names this node; no member has it.
            members: At most 16, known by their places.
            epoch: 32 bits, another one at every start; drawn at random, if there is a key from a source fit for keys.
            rng: For jitter and first sequence numbers.
            now: Monotonic seconds.
        """
        self._mac = mac
        self._probe_tries = max(config.tries, _LEAST_PROBE_TRIES)
        self._journal = Journal()
        self._graph = TopologyGraph(mac, config, epoch=epoch & 0xFFFFFFFF)
        context = Context(config, tuple(members), self._graph, self._journal, rng)
        seal = Seal(config.key, epoch=self._graph.own.epoch) if config.key else None
        self._outbox = Outbox(context, seal, self._close)
        self._retries = self._outbox.retries = Retries(context, self)
        self._links = LinkTable(context)
        self._neighbours = Neighbours(
            context,
            self._links,
            on_change=lambda now, is_loss: self._control.changed(is_loss=is_loss, now=now),
            on_down=self._clear,
            probe=lambda link, now: self.probe(link, now=now),
            now=now,
        )
        self._routes = Routes(self._graph, lambda node: self._links.best(node) is not None)
        self._floods = Floods(context, self._links, self._outbox)
        self._groups, self._arp = Groups(mac, now=now), Arp(mac)
        self._forwarder = Forwarder(
            context, self._links, self._routes, self._floods, self._outbox, self._groups, self._arp
        )
        self._control = Control(
            context,
            self._links,
            self._floods,
            self._outbox,
            next_sequence=self._forwarder.next_sequence,
            own_info=lambda: NodeInfo(0.0, self._arp.addresses, self._groups.macs),
            now=now,
        )
        self._receiver = Receiver(
            context,
            seal,
            self._links,
            self._floods,
            self._neighbours,
            self._outbox,
            self._retries,
            self._forwarder,
            self._control,
        )

    @property
    def mtu_bytes(self) -> int:
        """The MTU that the mesh interface may have so that everything fits, multicast to one destination at least:
        1500, or less where a member or the seal leaves less. A unicast frame may be 16 bytes longer."""
        overhead = wire.HEADER_BYTES + wire.forward_list_bytes([1]) + wire.ETHERNET_BYTES
        return min(MESH_MTU_BYTES, self._outbox.least_limit_bytes - overhead)

    @property
    def counts(self) -> dict[str, int]:
        """Everything counted so far, by the words of :class:`Count` and :class:`Drop`."""
        return {str(name): number for name, number in self._journal.counts.items()}

    def set_addresses(self, addresses: Sequence[bytes], *, now: float) -> None:
        """Tell this node's IPv4 addresses, of 4 bytes each: others then need not ask. Also learnt from its own ARP."""
        self._arp.tell(addresses)
        self._info_may_have_changed(now)

    # -- frames in ---------------------------------------------------------------------------------------------------

    def originate(self, inner: bytes, *, now: float) -> None:
        """Take an Ethernet frame from the mesh interface: to a node, a group or all; ARP, IGMP and MLD are read."""
        if len(inner) < wire.ETHERNET_BYTES:
            self._journal.count(Drop.TOO_SHORT)
            return
        if inner[6:12] != self._mac:
            self._journal.drop(Drop.FOREIGN_SOURCE, inner[6:12], inner[:6], len(inner), now=now)
            return
        if inner[0] & 1:
            memberships = groups.read(inner)
            if memberships is not None:
                self._groups.take(memberships, now=now)
                self._info_may_have_changed(now)
                return
        self._forwarder.originate(inner, now=now)
        if inner[12:14] == b"\x08\x06":
            self._info_may_have_changed(now)

    def receive(self, member: int, frame: bytes, *, now: float, reception: Reception | None = None) -> None:
        """Take a frame that came from a member, from its destination address on. Whatever it holds, never raises."""
        self._receiver.receive(member, frame, reception=reception, now=now)

    # -- frames out --------------------------------------------------------------------------------------------------

    def frames_to_send(self, *, now: float, room: Sequence[int] | None = None) -> list[Outgoing]:
        """Return what to send now, the most urgent first, and forget it.

        Args:
            now: Monotonic seconds; acknowledgements are awaited from here on.
            room: How many frames each member takes; None: as many as there are. What finds no room stays here, where
                more urgent frames overtake it and old ones are dropped.
        """
        return self._outbox.pull(now=now, room=room)

    def take_delivered(self) -> list[bytes]:
        """Return, once, the Ethernet frames for the mesh interface. At most 4096 are kept, the newest."""
        delivered = self._forwarder.delivered
        found = list(delivered)
        delivered.clear()
        return found

    # -- time --------------------------------------------------------------------------------------------------------

    def next_timer(self) -> float | None:
        """When :meth:`handle_timer` wants to be called; call it again after any other call. What is
        due to be sent then leaves with :meth:`frames_to_send`."""
        return min(
            self._outbox.next_due(),
            self._retries.next_due(),
            self._control.next_due(),
            self._neighbours.next_due(),
            self._groups.next_due(),
            self._graph.next_expiry,
        )

    def handle_timer(self, *, now: float) -> None:
        """Do what is due."""
        self._retries.handle(now=now)
        if self._neighbours.next_due() <= now:
            self._neighbours.handle(now=now)
        if self._graph.next_expiry <= now:
            self._graph.expire(now=now)
        if self._groups.next_due() <= now:
            self._forwarder.delivered.extend(self._groups.handle(now=now))
            self._info_may_have_changed(now)
        if self._control.next_due() <= now:
            self._control.handle(now=now)

    def _info_may_have_changed(self, now: float) -> None:
        before = self._graph.own.info
        self._control.refresh_info(now=now)
        if self._graph.own.info != before:
            self._control.changed(is_loss=False, now=now)

    # -- what is told ------------------------------------------------------------------------------------------------

    def next_event(self) -> Event | None:
        """Return the oldest event not told yet. The newest thousand are kept."""
        return self._journal.next_event()

    def snapshot(self, *, now: float) -> Snapshot:
        """Return links, topology, routes, groups and counters."""
        return reports.snapshot(
            self._graph,
            self._links,
            self._routes,
            self._floods.mprs,
            groups=self._groups.macs,
            queued=self._outbox.lengths,
            counts=self.counts,
            now=now,
        )

    def links(self, *, now: float) -> tuple[LinkState, ...]:
        """Return the links of this node, as in :meth:`snapshot`."""
        return reports.link_states(self._graph, self._links, self._floods.mprs, now=now)

    def count(self, what: Count | Drop) -> None:
        """Count what only the edge can see."""
        self._journal.count(what)

    # -- what the retries ask (wnet.core.retries.Owner) --------------------------------------------------------------

    def resend(self, transmission: Transmission, *, now: float) -> None:
        """Queue a transmission once more, ahead of others."""
        self._outbox.submit(transmission, now=now, is_first=True)

    def reroute(self, packet: Packet, entry: Entry, *, now: float) -> bool:
        """Send by another next hop what this one does not acknowledge."""
        return self._forwarder.reroute(packet, entry, now=now)

    def probe(self, link: Link, *, now: float) -> None:
        """Ask a neighbour for an acknowledgement, unless it is being asked already."""
        if link.probe is None:
            packet = Packet(wire.PROBE, b"", 1, CONTROL, None)
            link.probe = Transmission(packet, link.member, [Entry(link, ())], self._probe_tries)
            self._control.account(_PROBE_AND_ACK_BYTES, now=now)
            self._outbox.submit(link.probe, now=now)

    def lose(self, link: Link, reason: LinkDownReason, *, now: float) -> None:
        """Take a link out of use."""
        self._neighbours.take_down(link, reason, now=now)

    def probe_answered(self, link: Link, *, now: float) -> None:
        """The neighbour has acknowledged a probe."""
        was_usable = link.is_usable
        self._neighbours.probe_answered(link, now=now)
        if link.is_usable and not was_usable:
            self._control.synchronise(link, now=now)

    def _clear(self, link: Link, now: float) -> None:
        """Send by other ways what waits for a link that is gone, or is under way on it."""
        link.probe = None
        unanswered = self._retries.abandon(link)
        for transmission in self._outbox.take_out(link):
            unanswered += [(transmission, entry) for entry in transmission.entries]
            transmission.entries = []
        for transmission, entry in unanswered:
            self._forwarder.resubmit(transmission.packet, entry, now=now)

    def _close(self, transmission: Transmission, now: float) -> None:
        """Do the same for those next hops of one transmission that are gone."""
        for entry in [entry for entry in transmission.entries if not entry.link.is_usable]:
            self._retries.forget(transmission, entry)
            self._forwarder.resubmit(transmission.packet, entry, now=now)
