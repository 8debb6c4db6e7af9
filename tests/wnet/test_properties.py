"""What holds whatever happens: graphs, losses, cuts, restarts and silences drawn by Hypothesis.

No frame is forwarded twice by a node for one destination, none delivered twice or to who is not meant, relays cover all
two-hop neighbours by the node's own view, memory is bounded, no link that works in one direction only is used, and when
all is quiet everyone finds everyone whom a path of good links leads to.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from wnet.core import wire

RELAXED = settings(
    deadline=None,
    max_examples=25,
    phases=[Phase.explicit, Phase.generate],  # a story is long: shrinking one takes minutes
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
NAMES = "abcdefg"
GROUP = bytes.fromhex("01005e010101")
name = st.sampled_from(NAMES)
pair = st.tuples(name, name).filter(lambda ends: ends[0] != ends[1])

step = st.one_of(
    st.tuples(st.just("send"), pair, st.sampled_from([0, 46])),
    st.tuples(st.just("send"), pair, st.sampled_from([0, 46])),
    st.tuples(st.just("all"), name),
    st.tuples(st.just("group"), name),
    st.tuples(st.just("join"), name),
    st.tuples(st.just("cut"), pair),
    st.tuples(st.just("cut one way"), pair),
    st.tuples(st.just("mend"), pair),
    st.tuples(st.just("silence"), name),
    st.tuples(st.just("wake"), name),
    st.tuples(st.just("restart"), name),
    st.tuples(st.just("pass"), st.sampled_from([0.001, 0.03, 0.2, 2.0])),
    st.tuples(st.just("pass"), st.sampled_from([0.001, 0.03, 0.2, 2.0])),
)
stories = st.lists(step, min_size=5, max_size=40)


class Story:
    """A net whose frames of data are numbered and followed."""

    def __init__(self, net, pairs, losses) -> None:
        self.net = net
        self.number = 0
        self.meant: dict[bytes, set[str]] = {}
        for each in NAMES:
            net.add(each, redundant_dscp=46)
        for ends, loss in zip(pairs, losses, strict=False):
            if not net.between(*ends):
                net.radio(*ends, loss_ratio=loss)

    def tell(self, what: str, *details) -> None:
        """Do one step."""
        net = self.net
        if what == "pass":
            net.run(*details)
        elif what in ("send", "all", "group"):
            self._send(what, *details)
        elif what == "join":
            ip = bytes((0x45, 0)) + bytes(7) + b"\x02" + bytes(10)
            station = net.stations[details[0]]
            station.mesh.originate(GROUP + station.mac + b"\x08\x00" + ip + b"\x16\0\0\0\xef\1\1\1", now=net.now)
        elif what == "cut one way":
            net.one_way(*details[0], is_cut=True)
        elif what in ("cut", "mend"):
            net.change(*details[0], is_cut=what == "cut")
        elif what == "restart":
            was_silent = net.stations[details[0]].is_silent
            net.add(details[0], redundant_dscp=46).is_silent = was_silent
        else:
            net.stations[details[0]].is_silent = what == "silence"

    def _send(self, what: str, who, dscp: int = 0) -> None:
        self.number += 1
        payload = self.number.to_bytes(4, "big")
        source, *targets = who if isinstance(who, tuple) else (who,)
        if self.net.stations[source].is_silent:
            return
        self.meant[payload] = set(targets) or set(NAMES) - {source}
        target = {"all": b"\xff" * 6, "group": GROUP}.get(what) or targets[0]
        self.net.send(source, target, payload, dscp=dscp)

    def check(self) -> None:
        """Look at everything that was delivered and sent."""
        for each in NAMES:
            got = Counter(self.net.got(each))
            assert not [payload for payload, times in got.items() if times > 1], (each, got)
            assert all(each in self.meant[payload] for payload in got)
            self._check_sent(each)
            self._check_state(each)

    def _check_sent(self, each: str) -> None:
        """A frame leaves a node once for every destination; further tries and two other next hops aside."""
        station = self.net.stations[each]
        firsts: Counter[tuple[bytes, bytes]] = Counter()
        for _at, outgoing in station.sent:
            body = outgoing.frame[wire.ETHERNET_BYTES :]
            for part in wire.split(body) if body[0] == wire.AGGREGATE else [body]:
                data = wire.decode(part) if part[0] in (wire.UNICAST, wire.MULTICAST) else None
                if not isinstance(data, wire.Data) or data.attempt > 0:
                    continue
                listed = [d for hop in data.hops for d in hop.destinations] or [wire.destination_of(data.tail)]
                assert station.mac not in listed
                for destination in listed:
                    firsts[wire.key_of(data.tail), destination] += 1
        assert max(firsts.values(), default=0) <= 3

    def _check_state(self, each: str) -> None:
        net = self.net
        state = net.stations[each].mesh.snapshot(now=net.now)
        edges = {(edge.sender, edge.receiver) for edge in state.edges}
        assert all((b, a) in edges for a, b in edges)
        own = net.stations[each].mac
        near = {b for a, b in edges if a == own}
        relays = {link.neighbour for link in state.links if link.is_mpr}
        two_hops = {b for a, b in edges if a in near} - near - {own}
        assert two_hops <= {b for a, b in edges if a in relays}
        usable = {link.neighbour for link in state.links if link.is_usable}
        assert set(net.stations[each].mesh._links.usable_nodes()) == usable
        assert len(state.nodes) <= len(NAMES)
        for link in state.links:
            assert link.in_flight <= 1024 + 8
        mesh = net.stations[each].mesh
        assert mesh.next_timer() > net.now - 1.0 or net.stations[each].is_silent


@RELAXED
@given(
    st.lists(pair, min_size=4, max_size=16),
    st.lists(st.sampled_from([0.0, 0.0, 0.1, 0.3]), min_size=16, max_size=16),
    stories,
    st.integers(0, 2**32 - 1),
)
def test_whatever_happens(make_mesh_net, pairs, losses, story, seed: int) -> None:
    told = Story(make_mesh_net(seed=seed), pairs, losses)
    told.net.run(2.0)
    for each in story:
        told.tell(*each)
    told.net.run(2.0)
    told.check()


def test_who_does_not_hear_us_any_more_is_no_relay(make_mesh_net) -> None:
    """A story that was found so: d counts on a, which has told others that it lost d, and covers most."""
    pairs = [
        tuple(ends)
        for ends in ["dc", "ce", "gb", "be", "ce", "dg", "bf", "ad", "cd", "ea", "ce", "gb", "cg", "ba", "ga", "df"]
    ]
    losses = [0.0, 0.3, 0.3, 0.0, 0.1, 0.3, 0.0, 0.0, 0.0, 0.3, 0.3, 0.3, 0.3, 0.0, 0.1, 0.0]
    told = Story(make_mesh_net(seed=254412), pairs, losses)
    told.net.run(2.0)
    told.tell("restart", "f")
    told.tell("pass", 0.001)
    told.tell("restart", "f")
    for ends, dscp in (("cd", 46), ("fg", 0), ("gc", 46)):
        told.tell("send", tuple(ends), dscp)
    told.tell("join", "a")
    told.tell("send", ("a", "c"), 0)
    told.tell("cut", ("d", "a"))
    told.tell("send", ("f", "c"), 46)
    told.tell("pass", 0.001)
    told.tell("silence", "f")
    for ends in ("ad", "dg"):
        told.tell("pass", 0.2)
        told.tell("send", tuple(ends), 46)
    told.net.run(2.0)
    told.check()


@RELAXED
@given(st.lists(pair, min_size=4, max_size=16), stories, st.integers(0, 2**32 - 1))
def test_in_the_end_everyone_finds_everyone_whom_a_path_leads_to(make_mesh_net, pairs, story, seed: int) -> None:
    told = Story(make_mesh_net(seed=seed), pairs, [0.0] * 16)
    net = told.net
    for each in story:
        told.tell(*each)
    for each in NAMES:
        told.tell("wake", each)
    net.run(40.0)  # whoever was away for long is found again by the slow HELLOs
    groups = components({frozenset(ends) for ends in pairs if is_open(net, *ends)})
    for each in NAMES:
        state = net.stations[each].mesh.snapshot(now=net.now)
        reached = {next(s.name for s in net.stations.values() if s.mac == route.destination) for route in state.routes}
        assert reached == groups[each] - {each}
    for each in NAMES:
        walk(net, each, groups[each])


def is_open(net, a: str, b: str) -> bool:
    """Whether a link works in both directions."""
    return not any(path.is_cut for path in net.between(a, b))


def components(links: set[frozenset[str]]) -> dict[str, set[str]]:
    """The parts that the graph falls into, by member."""
    found = {each: {each} for each in NAMES}
    for link in links:
        a, b = link
        joined = found[a] | found[b]
        for each in joined:
            found[each] = joined
    return found


def walk(net, source: str, reachable: set[str]) -> None:
    """Follow next hops from node to node: every path ends at its destination."""
    tables = {
        station.mac: {route.destination: route.next_hop for route in station.mesh.snapshot(now=net.now).routes}
        for station in net.stations.values()
    }
    for destination in reachable - {source}:
        at, steps = net.stations[source].mac, [net.stations[source].mac]
        while at != net.stations[destination].mac:
            at = tables[at][net.stations[destination].mac]
            assert at not in steps, (source, destination)
            steps.append(at)
        assert all(a != b for a, b in pairwise(steps))
