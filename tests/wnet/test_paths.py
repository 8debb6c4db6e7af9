"""Paths, alternates and multipoint relays over drawn graphs."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from wnet.config import MeshConfig
from wnet.core import mpr
from wnet.core.routes import Routes, distances
from wnet.core.topology import MAX_LINKS, MAX_NODES, TopologyGraph
from wnet.core.wire_control import Attributes, Incoming, NodeInfo, Topology

Edge = tuple[int, int, float]


def mac(number: int) -> bytes:
    return bytes((2, 0, 0, 0, number >> 8, number & 0xFF))


def graph_of(edges: Iterable[Edge], own: int = 0) -> TopologyGraph:
    """A graph as node ``own`` would know it from everybody's word; edges are (sender, receiver, loss)."""
    graph = TopologyGraph(mac(own), MeshConfig(), epoch=1)
    incoming: dict[int, dict[int, float]] = {}
    for sender, receiver, loss in edges:
        incoming.setdefault(receiver, {})[sender] = loss
    for receiver, senders in incoming.items():
        links = {mac(s): (0, Attributes(loss, None, None)) for s, loss in senders.items()}
        if receiver == own:
            graph.set_own_links(links, now=0.0)
        else:
            told = tuple(Incoming(m, i, a) for m, (i, a) in links.items())
            graph.update(Topology(mac(receiver), 10.0, NodeInfo(), told), 1, 1, b"", age_s=0.0, now=0.0)
    return graph


def both(pairs: Iterable[tuple[int, int]], loss: float = 0.0) -> list[Edge]:
    return [edge for a, b in pairs for edge in ((a, b, loss), (b, a, loss))]


@st.composite
def meshes(draw: st.DrawFn) -> list[Edge]:
    """Up to 12 nodes; some links work in one direction only."""
    count = draw(st.integers(3, 12))
    rng = draw(st.randoms(use_true_random=False))
    density = draw(st.sampled_from([0.2, 0.35, 0.6]))
    pairs = [(a, b) for a in range(count) for b in range(a) if rng.random() < density]
    edges = both(pairs)
    one_way = [edge for edge in edges if rng.random() < 0.1]
    return [(a, b, rng.choice([0.0, 0.1, 0.3, 0.5])) for a, b, _loss in edges if (a, b, _loss) not in one_way]


def usable(edges: list[Edge]) -> set[tuple[int, int]]:
    """The links that work in both directions."""
    pairs = {(a, b) for a, b, _loss in edges}
    return {(a, b) for a, b in pairs if (b, a) in pairs}


def test_a_path_avoids_a_lossy_link() -> None:
    graph = graph_of(both([(0, 1)], loss=0.6) + both([(0, 2), (2, 1)]))
    routes = Routes(graph, lambda node: True)
    assert routes.path(mac(1)) == [mac(2), mac(1)]
    route = routes.get(mac(1))
    assert route is not None
    assert route.hops == (mac(2), mac(1))


def test_an_alternate_that_would_come_back_is_none() -> None:
    graph = graph_of(both([(0, 1), (0, 2), (1, 3)]))  # 2 reaches 3 only through 0
    route = Routes(graph, lambda node: True).get(mac(3))
    assert route is not None
    assert route.hops == (mac(1),)


def test_an_alternate_that_avoids_the_next_hop_altogether_comes_first() -> None:
    graph = graph_of(both([(0, 1), (1, 5), (0, 2), (2, 1), (0, 3), (3, 5)]))  # 2 is loop-free, but goes through 1
    route = Routes(graph, lambda node: True).get(mac(5))
    assert route is not None
    assert route.hops == (mac(1), mac(3), mac(2))


def test_a_link_in_one_direction_is_not_used() -> None:
    graph = graph_of([(0, 1, 0.0), *both([(0, 2), (2, 1)])])
    assert Routes(graph, lambda node: True).path(mac(1)) == [mac(2), mac(1)]


def test_a_disjoint_path_shares_no_relay() -> None:
    graph = graph_of(both([(0, 1), (1, 2), (0, 3), (3, 4), (4, 2), (1, 4)]))
    routes = Routes(graph, lambda node: True)
    assert routes.path(mac(2)) == [mac(1), mac(2)]
    assert routes.disjoint_path(mac(2)) == (mac(3), mac(4), mac(2))
    assert routes.disjoint_path(mac(1)) == ()  # a neighbour


@given(meshes())
def test_every_hop_is_nearer_to_the_destination(edges: list[Edge]) -> None:
    """So nodes with the same view never forward in a circle, and no alternate leads back."""
    graph, good = graph_of(edges), usable(edges)
    routes = Routes(graph, lambda node: True)
    for destination in graph.nodes:
        route = routes.get(destination)
        if route is None:
            continue
        far = distances(graph, destination)
        to_own = distances(graph, mac(0))
        assert (0, route.hops[0][5]) in good
        assert far[route.hops[0]] < far[mac(0)]
        for alternate in route.hops[1:]:
            assert (0, alternate[5]) in good
            assert far[alternate] < to_own.get(alternate, float("inf")) + far[mac(0)]


@given(meshes())
def test_a_path_is_made_of_links_that_work_in_both_directions(edges: list[Edge]) -> None:
    graph, good = graph_of(edges), usable(edges)
    routes = Routes(graph, lambda node: True)
    for destination in graph.nodes:
        path = [mac(0), *routes.path(destination)]
        assert all((a[5], b[5]) in good for a, b in pairwise(path))
        assert len(set(path)) == len(path)
        second = routes.disjoint_path(destination)
        assert not set(second[:-1]) & set(path[:-1])


@given(meshes())
def test_the_relays_reach_every_two_hop_neighbour(edges: list[Edge]) -> None:
    good = usable(edges)
    near = {b for a, b in good if a == 0}
    coverage = {n: frozenset(c for b, c in good if b == n and c != 0 and c not in near) for n in near}
    chosen = mpr.select(coverage, dict.fromkeys(near, 1.0))
    assert set().union(*(coverage[n] for n in chosen)) == set().union(*coverage.values())
    for relay in chosen:  # and none is needless
        others = set().union(*(coverage[n] for n in chosen if n != relay))
        assert not coverage[relay] <= others


def test_a_graph_is_bounded() -> None:
    graph = TopologyGraph(mac(0), MeshConfig(), epoch=1)
    for number in range(1, MAX_NODES + 500):
        links = tuple(Incoming(mac(n), 0, Attributes(0.0, None, None)) for n in range(MAX_LINKS + 50))
        graph.update(Topology(mac(number), 10.0, NodeInfo(), links), 1, 1, b"", age_s=0.0, now=0.0)
        if number > 20:
            break
    assert all(len(node.incoming) <= MAX_LINKS for node in graph.nodes.values())
    for number in range(MAX_NODES + 500):
        graph.update(Topology(mac(number + 1), 10.0, NodeInfo(), ()), 1, 1, b"", age_s=0.0, now=0.0)
    assert len(graph.nodes) == MAX_NODES


def test_a_node_is_forgotten_in_time_and_its_old_word_does_not_bring_it_back() -> None:
    graph = TopologyGraph(mac(0), MeshConfig(), epoch=1)
    topology = Topology(mac(1), 10.0, NodeInfo(), ())
    assert graph.update(topology, 1, 1, b"tail", age_s=0.0, now=0.0)
    graph.expire(now=34.0)
    assert mac(1) in graph.nodes
    graph.expire(now=36.0)
    assert mac(1) not in graph.nodes
    assert not graph.update(topology, 1, 1, b"tail", age_s=36.0, now=36.0)
    assert graph.digest == TopologyGraph(mac(0), MeshConfig(), epoch=1).digest


def test_older_news_do_not_replace_newer_ones_over_the_wrap_of_the_sequence() -> None:
    graph = TopologyGraph(mac(0), MeshConfig(), epoch=1)
    topology = Topology(mac(1), 10.0, NodeInfo(), ())
    graph.update(topology, 5, 2**32 - 1, b"tail", age_s=0.0, now=0.0)
    assert graph.is_newer(mac(1), 5, 3)
    assert not graph.is_newer(mac(1), 5, 2**32 - 2)
    graph.update(topology, 6, 1, b"tail", age_s=0.0, now=0.0)  # restarted
    assert not graph.is_newer(mac(1), 5, 7)
    assert graph.is_newer(mac(1), 6, 2)
