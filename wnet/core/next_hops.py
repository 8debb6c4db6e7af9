"""Which neighbour a frame goes to next: the best one, or an alternate while that one owes acknowledgements."""

from __future__ import annotations

from wnet.core.events import AlternateUsed, Count, Drop, RouteChanged
from wnet.core.journal import Journal
from wnet.core.link import Link
from wnet.core.links import LinkTable
from wnet.core.routes import Route, Routes
from wnet.core.transmissions import Packet

_MAX_TOLD = 1024


class NextHops:
    """The choice, and the events about it; of the last 1024 destinations at most."""

    def __init__(self, routes: Routes, links: LinkTable, journal: Journal) -> None:
        self._routes = routes
        self._links = links
        self._journal = journal
        self._told: dict[bytes, bytes | None] = {}
        self._avoided: dict[bytes, bytes] = {}

    def choose(self, packet: Packet, destination: bytes, *, but: Link | None, now: float) -> Link | Drop:
        """Return the link to send by, other than ``but`` and not back to where the packet came from, or why none.

        A suspect one is returned only if all are.
        """
        route = self._routes.get(destination)
        hops = route.hops if route is not None else ()
        self._tell_route(destination, route, now)
        fallback: Link | None = None
        for hop in hops:
            link = self._links.best(hop)
            if link is None or link is but or hop == packet.via:
                continue
            if not link.is_suspect:
                if hop != hops[0]:
                    self._note_alternate(destination, hops[0], hop, now)
                elif destination in self._avoided:
                    del self._avoided[destination]
                return link
            fallback = fallback or link
        return fallback or (Drop.RETURNED if packet.via in hops else Drop.NO_ROUTE)

    def _note_alternate(self, destination: bytes, next_hop: bytes, alternate: bytes, now: float) -> None:
        self._journal.count(Count.ALTERNATE)
        if self._avoided.get(destination) != next_hop and len(self._avoided) < _MAX_TOLD:
            self._avoided[destination] = next_hop
            self._journal.tell(AlternateUsed(now, destination, next_hop, alternate))

    def _tell_route(self, destination: bytes, route: Route | None, now: float) -> None:
        next_hop = None if route is None else route.hops[0]
        if self._told.get(destination) == next_hop:
            return
        if len(self._told) >= _MAX_TOLD:
            self._told.clear()
        self._told[destination] = next_hop
        self._journal.tell(RouteChanged(now, destination, next_hop, None if route is None else route.cost))
