"""The state of the parts of a mesh, gathered into one :class:`~wnet.core.snapshot.Snapshot`."""

from __future__ import annotations

from collections.abc import Mapping

from wnet.core.link import Link
from wnet.core.links import LinkTable
from wnet.core.routes import Routes
from wnet.core.snapshot import EdgeState, LinkState, NodeState, RouteState, Snapshot
from wnet.core.topology import TopologyGraph


def snapshot(
    graph: TopologyGraph,
    links: LinkTable,
    routes: Routes,
    mprs: frozenset[bytes],
    *,
    groups: tuple[bytes, ...],
    queued: tuple[int, ...],
    counts: Mapping[str, int],
    now: float,
) -> Snapshot:
    """Return everything at ``now``."""
    found = _routes(graph, routes)
    reachable = {route.destination for route in found} | {graph.own.mac}
    nodes = tuple(
        NodeState(
            node.mac,
            node.epoch,
            node.info.utilisation_ratio,
            node.info.addresses,
            node.info.groups,
            node.mac in reachable,
        )
        for node in graph.nodes.values()
    )
    own, told = graph.own, link_states(graph, links, mprs, now=now)
    return Snapshot(now, own.mac, own.epoch, told, nodes, _edges(graph, now), found, groups, queued, counts)


def link_states(graph: TopologyGraph, links: LinkTable, mprs: frozenset[bytes], *, now: float) -> tuple[LinkState, ...]:
    """Return the links of this node alone, which costs no search for paths."""
    return tuple(_link(graph, link, link.neighbour in mprs, now) for link in links)


def _link(graph: TopologyGraph, link: Link, is_mpr: bool, now: float) -> LinkState:
    told, incoming = link.told, link.incoming()
    return LinkState(
        neighbour=link.neighbour,
        member=link.member,
        peer_mac=link.peer_mac,
        link_id=link.link_id,
        is_usable=link.is_usable,
        is_mpr=is_mpr,
        heard_s=now - link.last_heard,
        loss_in_ratio=incoming.loss_ratio,
        loss_out_ratio=None if told is None else told.loss_ratio,
        snr_in_db=incoming.snr_db,
        snr_out_db=None if told is None else told.snr_db,
        srtt_s=link.timer.srtt_s,
        quality=0.0 if told is None else graph.quality(graph.own.mac, link.neighbour, told),
        cost_out=graph.cost(graph.own.mac, link.neighbour),
        rate_bps=None if told is None else told.rate_bps,
        in_flight=len(link.pending),
    )


def _edges(graph: TopologyGraph, now: float) -> tuple[EdgeState, ...]:
    found = []
    for node in graph.nodes.values():
        for sender, cost in graph.senders_to(node.mac).items():
            edge = node.incoming[sender]
            told = edge.attributes
            quality = graph.quality(sender, node.mac, told)
            found.append(
                EdgeState(sender, node.mac, edge.link_id, told.loss_ratio, told.snr_db, quality, cost, now - edge.stamp)
            )
    return tuple(found)


def _routes(graph: TopologyGraph, routes: Routes) -> tuple[RouteState, ...]:
    found = []
    for mac in graph.nodes:
        route = routes.get(mac)
        if route is not None:
            found.append(RouteState(mac, route.hops[0], route.cost, routes.hops_to(mac), route.hops[1:]))
    return tuple(found)
