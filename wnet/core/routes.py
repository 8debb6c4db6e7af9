"""Paths over the topology graph: the next hops towards a node, loop-free alternates, and paths that share no node.

The Dijkstra algorithm runs from the destination over the reversed links: one run tells the distance of every node to
it, hence this node's next hop and all alternates at once. Runs are made when first asked for and kept as long as the
graph stays as it is.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import NamedTuple

from wnet.core.topology import TopologyGraph

_SLACK = 1e-9


class Route(NamedTuple):
    """``hops``: neighbours towards a node, the next hop first, then loop-free alternates; ``cost`` of the first."""

    hops: tuple[bytes, ...]
    cost: float


def distances(
    graph: TopologyGraph, destination: bytes, *, without: frozenset[bytes] = frozenset()
) -> dict[bytes, float]:
    """Return the cost of the best path from every node that has one to ``destination`` (Dijkstra 1959).

    ``without``: nodes that no path may pass; they may begin or end one.
    """
    found: dict[bytes, float] = {}
    heap = [(0.0, destination)]
    while heap:
        cost, node = heapq.heappop(heap)
        if node in found:
            continue
        found[node] = cost
        if node in without and node != destination:
            continue
        for sender, link in graph.senders_to(node).items():
            if sender not in found:
                heapq.heappush(heap, (cost + link, sender))
    return found


class Routes:
    """One node's routes. ``is_open(neighbour)``: whether there is a link to send on at the moment."""

    def __init__(self, graph: TopologyGraph, is_open: Callable[[bytes], bool]) -> None:
        self._graph = graph
        self._own = graph.own.mac
        self._is_open = is_open
        self._version = -1
        self._routes: dict[bytes, Route | None] = {}
        self._distances: dict[bytes, dict[bytes, float]] = {}
        self._second: dict[bytes, tuple[bytes, ...]] = {}
        self._listeners: dict[bytes, tuple[bytes, ...]] = {}

    def get(self, destination: bytes) -> Route | None:
        """Return how to reach a node, None if it cannot be reached."""
        if self._version != self._graph.version:
            self._forget()
        if destination in self._routes:
            return self._routes[destination]
        if destination not in self._graph.nodes:
            return None
        route = self._routes[destination] = self._find(destination)
        return route

    def hops_to(self, destination: bytes) -> int:
        """Return how many links the best path has, as far as this node can tell; 0 if there is none."""
        return len(self.path(destination))

    def path(self, destination: bytes, *, without: frozenset[bytes] = frozenset()) -> list[bytes]:
        """Return the nodes of the best path that passes none of ``without``, the destination last; empty if none."""
        distance = self._to(destination) if not without else distances(self._graph, destination, without=without)
        path: list[bytes] = []
        at = self._own
        while at != destination and at in distance and len(path) < len(self._graph.nodes):
            step = self._step(at, distance, without, destination)
            if step is None:
                return []
            path.append(step)
            at = step
        return path if at == destination else []

    def disjoint_path(self, destination: bytes) -> tuple[bytes, ...]:
        """Return the best path that shares no relay with the best of all; empty if there is none."""
        if self._version != self._graph.version:
            self._forget()
        found = self._second.get(destination)
        if found is None:
            best = self.path(destination)
            second = self.path(destination, without=frozenset(best[:-1])) if len(best) > 1 else []
            found = self._second[destination] = tuple(second)
        return found

    def listeners(self, group: bytes) -> tuple[bytes, ...]:
        """Return the other nodes that listen to a multicast group (a MAC address) and can be reached."""
        if self._version != self._graph.version:
            self._forget()
        found = self._listeners.get(group)
        if found is None:
            nodes = [node.mac for node in self._graph.nodes.values() if group in node.info.groups]
            found = self._listeners[group] = tuple(mac for mac in nodes if self.get(mac) is not None)
        return found

    def _step(
        self, at: bytes, distance: dict[bytes, float], without: frozenset[bytes], destination: bytes
    ) -> bytes | None:
        choices = []
        for node, rest in distance.items():
            cost = self._graph.senders_to(node).get(at)
            if cost is None or (node in without and node != destination) or rest >= distance[at]:
                continue
            if at != self._own or self._is_open(node):
                choices.append((cost + rest, node))
        return min(choices)[1] if choices else None

    def _find(self, destination: bytes) -> Route | None:
        if destination == self._own:
            return None
        to_destination = self._to(destination)
        candidates = []
        for neighbour in self._graph.own.incoming:
            link = self._graph.cost(self._own, neighbour)
            rest = to_destination.get(neighbour)
            if link is not None and rest is not None and self._is_open(neighbour):
                candidates.append((link + rest, neighbour, rest))
        if not candidates:
            return None
        candidates.sort()
        cost, best, _rest = candidates[0]
        return Route((best, *self._alternates(candidates[1:], best, to_destination)), cost)

    def _alternates(
        self, candidates: list[tuple[float, bytes, float]], best: bytes, to_destination: dict[bytes, float]
    ) -> list[bytes]:
        """Return the loop-free ones (RFC 5286, inequality 1), those that avoid the best one's node (3) first."""
        to_own, to_best = self._to(self._own), self._to(best)
        own_rest, best_rest = to_destination.get(self._own, float("inf")), to_destination[best]
        protecting: list[bytes] = []
        others: list[bytes] = []
        for _cost, neighbour, rest in candidates:
            if rest + _SLACK >= to_own.get(neighbour, float("inf")) + own_rest:
                continue
            is_protecting = rest + _SLACK < to_best.get(neighbour, float("inf")) + best_rest
            (protecting if is_protecting else others).append(neighbour)
        return protecting + others

    def _to(self, destination: bytes) -> dict[bytes, float]:
        if self._version != self._graph.version:
            self._forget()
        found = self._distances.get(destination)
        if found is None:
            found = self._distances[destination] = distances(self._graph, destination)
        return found

    def _forget(self) -> None:
        self._version = self._graph.version
        self._routes.clear()
        self._distances.clear()
        self._second.clear()
        self._listeners.clear()
