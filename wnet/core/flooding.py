"""Frames for all: broadcast data and TCs, relayed by multipoint relays only (WNet paper, III-C)."""

from __future__ import annotations

from typing import NamedTuple

from wnet.core import mpr, wire
from wnet.core.context import Context
from wnet.core.link import Link
from wnet.core.links import LinkTable
from wnet.core.outbox import Outbox
from wnet.core.transmissions import Entry, Packet, Transmission


class _Plan(NamedTuple):
    """``relays``: of every member with neighbours, the links to those that shall relay; ``alone``: the one neighbour on
    a member that has no other."""

    mprs: frozenset[bytes]
    relays: dict[int, list[Link]]
    alone: dict[int, bytes]


class Floods:
    """Who relays this node's floods, and sending them."""

    def __init__(self, context: Context, links: LinkTable, outbox: Outbox) -> None:
        self._graph = context.graph
        self._links = links
        self._outbox = outbox
        self._members = context.members
        self._tries = context.config.broadcast_tries
        self._jitter_s = context.config.relay_jitter_s
        self._rng = context.rng
        self._version = -1
        self._plan = _Plan(frozenset(), {}, {})

    @property
    def mprs(self) -> frozenset[bytes]:
        """The neighbours that relay what this node sends to all."""
        return self._current().mprs

    def send(self, packet: Packet, *, is_retried: bool, now: float) -> bool:
        """Send to all neighbours, on every member that is the best way to one; return whether there are any."""
        plan = self._current()
        for member, links in plan.relays.items():
            if not self._members[member].is_radio and plan.alone.get(member) == packet.via is not None:
                continue
            limit = self._outbox.limit_bytes(member) - wire.HEADER_BYTES - len(packet.tail)
            entries = [Entry(link, ()) for link in links if wire.relay_list_bytes(len(links)) <= limit]
            tries = self._tries if is_retried else 1
            transmission = Transmission(packet, member, entries, tries, is_group=True)
            if packet.via is not None and self._members[member].is_radio:
                self._outbox.submit_later(transmission, self._jitter_s * self._rng.random(), now=now)
            else:
                self._outbox.submit(transmission, now=now)
        return bool(plan.relays)

    def send_to(self, link: Link, packet: Packet, *, now: float) -> None:
        """Send to one neighbour, which shall relay it."""
        self._outbox.submit(Transmission(packet, link.member, [Entry(link, ())], 1, is_group=True), now=now)

    def is_gap(self, link: Link, *, now: float) -> bool:
        """Whether this node should relay unasked what came by ``link``: the sender may not know this node's links yet,
        as that one is not up or another has just come up, and one of the neighbours does not hear the sender."""
        if link.is_usable and not self._links.is_news(now=now):
            return False
        nodes, sender = self._graph.nodes, link.neighbour
        return any(
            node != sender and (node not in nodes or sender not in nodes[node].incoming)
            for node in self._links.usable_nodes()
        )

    def _current(self) -> _Plan:
        if self._version != self._graph.version:
            self._version = self._graph.version
            self._plan = self._make()
        return self._plan

    def _make(self) -> _Plan:
        best = self._links.usable_nodes()
        own = self._graph.own.mac
        costs = {node: cost for node in best if (cost := self._graph.cost(own, node)) is not None}
        coverage: dict[bytes, set[bytes]] = {node: set() for node in costs}  # who does not hear us relays nothing
        for node in self._graph.nodes:
            if node != own and node not in costs:
                for sender in self._graph.senders_to(node):
                    if sender in coverage:
                        coverage[sender].add(node)
        mprs = mpr.select({node: frozenset(covered) for node, covered in coverage.items()}, costs)
        relays: dict[int, list[Link]] = {}
        on_member: dict[int, list[bytes]] = {}
        for node, link in best.items():
            on_member.setdefault(link.member, []).append(node)
            relays.setdefault(link.member, [])
            if node in mprs:
                relays[link.member].append(link)
        alone = {member: nodes[0] for member, nodes in on_member.items() if len(nodes) == 1}
        return _Plan(mprs, relays, alone)
