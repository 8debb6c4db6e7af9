"""All links of one node: found by the addresses of a frame, the best one to each neighbour, and what is told of them.

Bounded: 256 links; who never became a neighbour goes first. What makes a link usable is not decided here.
"""

from __future__ import annotations

from collections.abc import Iterator

from wnet.core.context import Context
from wnet.core.link import Link
from wnet.core.wire_control import Attributes, Heard

MAX_LINKS = 256
_NEWS_S = 1.0


class LinkTable:
    """The links, and the part of the time that each neighbour sends."""

    def __init__(self, context: Context) -> None:
        self._rto_min_s = context.config.rto_min_s
        self._members = context.members
        self._graph = context.graph
        self._links: dict[tuple[int, bytes], Link] = {}
        self._best: dict[bytes, Link] = {}
        self._sending: dict[bytes, float] = {}
        self._up_at = float("-inf")

    def __iter__(self) -> Iterator[Link]:
        return iter(self._links.values())

    def find(self, member: int, peer_mac: bytes) -> Link | None:
        """Return the link on which a frame with this source address came."""
        return self._links.get((member, peer_mac))

    def add(self, member: int, peer_mac: bytes, node: bytes) -> Link | None:
        """Return a new link to a node, None if there is no room."""
        if len(self._links) >= MAX_LINKS and not self._make_room():
            return None
        own_mac = self._members[member].mac
        link = self._links[member, peer_mac] = Link(member, own_mac, peer_mac, node, rto_min_s=self._rto_min_s)
        return link

    def _make_room(self) -> bool:
        idle = [link for link in self._links.values() if not link.is_usable]
        if not idle:
            return False
        oldest = min(idle, key=lambda link: (link.is_lost, link.is_listed, link.last_heard))
        self.forget(oldest)
        return True

    def forget(self, link: Link) -> None:
        """Take a link out."""
        del self._links[link.member, link.peer_mac]
        self._sending.pop(link.neighbour, None)

    def note_up(self, *, now: float) -> None:
        """Note that a link came up."""
        self._up_at = now

    def is_news(self, *, now: float) -> bool:
        """Whether a link came up so recently that neighbours may not know it, and so not choose this node as a relay
        where it is the only one: it then relays unasked."""
        return now - self._up_at < _NEWS_S

    # -- the best ones -----------------------------------------------------------------------------------------------

    def best(self, node: bytes) -> Link | None:
        """Return the link to use to a neighbour, None if there is none."""
        return self._best.get(node)

    def usable_nodes(self) -> dict[bytes, Link]:
        """Return the neighbours that can be used, with the link to use to each."""
        return self._best

    def update_best(self, node: bytes) -> None:
        """Choose the link to use to a neighbour: the one that receives this node's frames best."""
        usable = [link for link in self._links.values() if link.neighbour == node and link.is_usable]
        if not usable:
            self._best.pop(node, None)
            return
        own = self._graph.own.mac
        self._best[node] = max(
            usable,
            key=lambda link: (
                not link.is_suspect,
                self._graph.quality(own, node, link.told) if link.told else 0.0,
                -link.member,
            ),
        )

    # -- what is told ------------------------------------------------------------------------------------------------

    @property
    def sending_ratio(self) -> float:
        """The parts of the time that the neighbours send, added up."""
        return sum(self._sending.values())

    def note_sending(self, node: bytes, ratio: float) -> None:
        """Note the part of the time that a node near by sends."""
        if node in self._best or len(self._sending) < MAX_LINKS:
            self._sending[node] = ratio

    def publish(self, *, now: float) -> None:
        """Bring the links that this node tells of up to date in the graph."""
        links: dict[bytes, tuple[int, Attributes]] = {}
        for link in self._links.values():
            if link.is_usable:
                incoming = link.incoming()
                if link.neighbour not in links or is_better(incoming, links[link.neighbour][1]):
                    links[link.neighbour] = (link.link_id, incoming)
        self._graph.set_own_links(links, now=now)
        for node in links.keys() | self._best.keys():
            self.update_best(node)

    def heard(self, member: int, *, is_partial: bool, mprs: frozenset[bytes], now: float) -> tuple[Heard, ...]:
        """Return what a HELLO on ``member`` lists: who is heard there, and the best links elsewhere.

        ``is_partial``: only who is heard but no neighbour yet.
        """
        found = []
        for link in self._links.values():
            if link.is_usable:
                if not is_partial and (link.member == member or self._best.get(link.neighbour) is link):
                    found.append(self._entry(link, mprs))
            elif link.member == member and _is_heard(link, now):
                found.append(self._entry(link, mprs))
        return tuple(found)

    def _entry(self, link: Link, mprs: frozenset[bytes]) -> Heard:
        return Heard(
            link.neighbour,
            link.epoch,
            link.peer_member,
            link.member,
            link.link_id,
            link.is_usable,
            link.neighbour in mprs,
            link.incoming(),
            link.told,
        )


def _is_heard(link: Link, now: float) -> bool:
    if now - link.last_heard > 3.5 * max(link.interval_s, 0.1):
        return False
    return link.lost_at is None or link.last_heard > link.lost_at


def is_better(one: Attributes, other: Attributes) -> bool:
    """Whether of two links to one neighbour the first receives better."""
    return (-one.loss_ratio, one.snr_db or 0.0) > (-other.loss_ratio, other.snr_db or 0.0)
