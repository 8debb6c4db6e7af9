"""Who is near: how the links to neighbours come up, by HELLO and probe, and how they go.

Theory of operation.
* A HELLO makes its sender known. One that lists this node, with its present epoch, shows that the neighbour hears it;
  the link is then probed, and is up once the probe is acknowledged. So no frame that needs an acknowledgement ever goes
  out on a link that works in one direction only, and a recorded HELLO of another day leads to nothing.
* A link goes down when the neighbour does not answer (:mod:`wnet.core.retries`), when its HELLO does not list this node
  any more, or when it was started anew. Silence alone only leads to a probe, after two and a half HELLO intervals, or
  sooner where steady traffic has stopped.
"""

from __future__ import annotations

from collections.abc import Callable

from wnet.core.context import Context
from wnet.core.events import Count, LinkDown, LinkDownReason, LinkUp
from wnet.core.link import Link
from wnet.core.links import LinkTable, is_better
from wnet.core.members import Reception
from wnet.core.wire_control import Attributes, Hello

LOSS_INTERVAL_S = 5.0
"""How often a new loss ratio is made."""
_FORGET_AFTER_S = 600.0
_TRAFFIC_S = 2.0
"""A link that carried data within this before it was lost is missed, and searched for often."""


class Neighbours:
    """What HELLOs, probes and silence mean for the links of one node.

    ``on_change`` is called, with whether it is a loss, when links came or went or someone new was heard; ``on_down``
    for a link that is no longer used; ``probe`` to have one acknowledged.
    """

    def __init__(
        self,
        context: Context,
        links: LinkTable,
        *,
        on_change: Callable[[float, bool], None],
        on_down: Callable[[Link, float], None],
        probe: Callable[[Link, float], None],
        now: float,
    ) -> None:
        self._noise_dbm = context.config.noise_dbm
        self._graph = context.graph
        self._journal = context.journal
        self._links = links
        self._on_change = on_change
        self._on_down = on_down
        self._probe = probe
        self._loss_due = now + LOSS_INTERVAL_S

    # -- what is heard -----------------------------------------------------------------------------------------------

    def take_hello(
        self, member: int, peer_mac: bytes, hello: Hello, *, reception: Reception | None, now: float
    ) -> Link | None:
        """Take a HELLO; return its link, None if it is not to be believed."""
        own = self._graph.own
        if hello.node == own.mac:
            self._journal.count(Count.OWN)
            if hello.epoch != own.epoch:
                self._journal.conflict(own.mac, peer_mac, now=now)
            return None
        if self._graph.is_former(hello.node, hello.epoch):
            self._journal.conflict(hello.node, peer_mac, now=now)
            return None
        link = self._link(member, peer_mac, hello, now)
        if link is None:
            return None
        ahead = link.hello_window.take(hello.sequence)
        if ahead < 0:
            self._journal.count(Count.DUPLICATE)
            return None
        is_new = link.last_heard == float("-inf") or (link.is_lost and link.last_heard <= (link.lost_at or 0.0))
        link.loss.count(ahead)
        link.hear(reception, self._noise_dbm, now=now)
        link.peer_member, link.interval_s, link.digest = hello.member, hello.interval_s, hello.digest
        self._read_own_entry(link, hello, now)
        self._read_others(hello, now)
        if is_new:
            self._on_change(now, False)
        return link

    def _link(self, member: int, peer_mac: bytes, hello: Hello, now: float) -> Link | None:
        link = self._links.find(member, peer_mac)
        if link is not None and (link.neighbour, link.epoch) != (hello.node, hello.epoch):
            if link.is_usable:
                self.take_down(link, LinkDownReason.RESTARTED, now=now)
            link.neighbour, link.epoch = hello.node, hello.epoch
            link.is_listed, link.lost_at, link.agreed_at = False, None, float("-inf")
            link.forget_direction_in()
            link.forget_direction_out()
        if link is None:
            link = self._links.add(member, peer_mac, hello.node)
            if link is not None:
                link.epoch = hello.epoch
        return link

    def _read_own_entry(self, link: Link, hello: Hello, now: float) -> None:
        own = self._graph.own
        entry = next(
            (
                heard
                for heard in hello.links
                if heard.node == own.mac and heard.peer_member == link.member and heard.own_member == hello.member
            ),
            None,
        )
        if entry is None and hello.is_partial:
            return
        link.is_listed = entry is not None and entry.epoch == own.epoch
        if entry is not None and link.is_listed:
            link.told = entry.incoming
            if not link.is_usable:
                self._probe(link, now)
        elif link.is_usable:
            self.take_down(link, LinkDownReason.NOT_HEARD_BACK, now=now)

    def _read_others(self, hello: Hello, now: float) -> None:
        """Put what a neighbour tells of its links into the graph."""
        links: dict[bytes, tuple[int, Attributes]] = {}
        hold_s = 3.5 * max(hello.interval_s, 1.0)
        for heard in hello.links:
            if heard.is_usable and (heard.node not in links or is_better(heard.incoming, links[heard.node][1])):
                links[heard.node] = (heard.link_id, heard.incoming)
        told = None if hello.is_partial else links
        self._graph.update_neighbour(hello.node, hello.epoch, hello.info, told, hold_s=hold_s, now=now)
        if hello.is_partial:
            for node, (link_id, incoming) in links.items():
                self._graph.update_edge(node, hello.node, link_id, incoming, now=now)
        else:
            for heard in hello.links:
                if heard.is_usable and heard.outgoing is not None:
                    self._graph.suppose(hello.node, heard.node, heard.outgoing, hold_s=hold_s, now=now)
        self._links.note_sending(hello.node, hello.own_utilisation_ratio)
        self._links.update_best(hello.node)

    # -- up and down -------------------------------------------------------------------------------------------------

    def probe_answered(self, link: Link, *, now: float) -> None:
        """Use a link whose neighbour has acknowledged a probe and hears this node as it is now."""
        if link.is_usable or not link.is_listed:
            return
        link.is_usable = True
        link.lost_at = None
        self._links.note_up(now=now)
        link.link_id = (link.link_id + 1) & 0x0F
        self._journal.tell(LinkUp(now, link.neighbour, link.member, link.peer_mac, link.link_id))
        self._republish(now)
        self._on_change(now, False)

    def take_down(self, link: Link, reason: LinkDownReason, *, now: float) -> None:
        """Use a link no more."""
        link.is_usable = link.is_listed = False
        link.lost_at = now
        link.is_missed = now - max(link.last_data, link.last_sending) < _TRAFFIC_S
        self._journal.tell(LinkDown(now, link.neighbour, link.member, link.peer_mac, link.link_id, reason))
        self._republish(now)
        self._on_change(now, True)
        self._on_down(link, now)

    def _republish(self, now: float) -> None:
        self._links.publish(now=now)
        self._graph.changed()  # of two links to one neighbour the other may look the same

    # -- time --------------------------------------------------------------------------------------------------------

    def next_due(self) -> float:
        """When :meth:`handle` has something to do."""
        silent = (link.silence_due for link in self._links if link.is_usable and link.probe is None)
        return min(self._loss_due, min(silent, default=float("inf")))

    def handle(self, *, now: float) -> None:
        """Probe who is silent; make new loss ratios."""
        for link in self._links:
            if link.is_usable and link.probe is None and link.silence_due <= now:
                link.gap_s = None
                self._probe(link, now)
        if self._loss_due <= now:
            self._loss_due = now + LOSS_INTERVAL_S
            self._close_loss_interval(now)

    def _close_loss_interval(self, now: float) -> None:
        for link in list(self._links):
            link.loss.close_interval()
            if not link.is_usable and now - max(link.last_heard, link.lost_at or 0.0) > _FORGET_AFTER_S:
                self._links.forget(link)
        self._links.publish(now=now)
