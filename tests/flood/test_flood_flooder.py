"""A flood over any topology, in virtual time: everybody gets everything once, nobody sends anything twice."""

from __future__ import annotations

import heapq
import random
from collections import Counter
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.flood.flooder import QUEUE_LIMIT, Count, Flooder, Member
from netlab.flood.wire import Fault, Header, decode, encode
from netlab.medium.meshes import FloodOptions

GROUP = b"\xff" * 6


def mac(node: int) -> bytes:
    return b"\x02\x4e\x4d\x00\x00" + bytes([node])


@dataclass
class World:
    """``segments`` are sets of nodes that share a medium: two for a wire, any number for a radio (``is_radio``)."""

    nodes: int
    segments: list[tuple[tuple[int, ...], bool]]
    loss_ratio: float = 0.0
    options: FloodOptions = field(default_factory=FloodOptions)
    seed: int = 1
    now: float = 0.0
    sent: Counter[tuple[int, int, int]] = field(default_factory=Counter)  # (node, segment, sequence of originator 0)
    delivered: Counter[tuple[int, bytes]] = field(default_factory=Counter)  # (node, inner frame)

    def __post_init__(self) -> None:
        self._rng = random.Random(self.seed)
        self._on = {node: [s for s, (who, _) in enumerate(self.segments) if node in who] for node in range(self.nodes)}
        self.flooders = {
            node: Flooder(
                mac(node),
                [Member(bytes([2, node, 0, 0, 0, s]), self.segments[s][1]) for s in self._on[node]],
                self.options,
                epoch=0,
                rng=random.Random(f"{self.seed}/{node}"),
            )
            for node in range(self.nodes)
        }
        self._flying: list[tuple[float, int, int, int, bytes]] = []  # due, order, node, member, frame
        self._order = 0

    def originate(self, node: int, to: bytes = GROUP, text: bytes = b"x") -> bytes:
        inner = to + mac(node) + b"\x08\x00" + text
        self._transmit(node, self.flooders[node].originate(inner))
        return inner

    def run(self) -> None:
        """Until nothing moves any more."""
        while True:
            waiting = [due for flooder in self.flooders.values() if (due := flooder.next_due()) is not None]
            times = waiting + [flight[0] for flight in self._flying[:1]]
            if not times:
                return
            self.now = max(self.now, min(times))
            for node, flooder in self.flooders.items():
                self._transmit(node, flooder.due(now=self.now))
            while self._flying and self._flying[0][0] <= self.now:
                _, _, node, member, frame = heapq.heappop(self._flying)
                inner = self.flooders[node].receive(member, frame, now=self.now)
                if inner is not None:
                    self.delivered[node, inner] += 1

    def _transmit(self, node: int, sendings: list[tuple[int, bytes]]) -> None:
        for member, frame in sendings:
            segment = self._on[node][member]
            header = decode(frame)
            assert isinstance(header, Header)
            assert frame[:6] == GROUP
            self.sent[node, segment, header.sequence] += 1
            for other in self.segments[segment][0]:
                if other != node and self._rng.random() >= self.loss_ratio:
                    self._order += 1
                    due = self.now + 0.001 * self._rng.random()
                    heapq.heappush(self._flying, (due, self._order, other, self._on[other].index(segment), frame))


def wires(*ends: tuple[int, int]) -> list[tuple[tuple[int, ...], bool]]:
    return [(pair, False) for pair in ends]


LINE = wires((0, 1), (1, 2), (2, 3))
DIAMOND = wires((0, 1), (0, 2), (1, 3), (2, 3))


@st.composite
def worlds(draw: st.DrawFn) -> World:
    nodes = draw(st.integers(2, 7))
    pairs = [(a, b) for a in range(nodes) for b in range(a)]
    segments = wires(*draw(st.lists(st.sampled_from(pairs), unique=True, max_size=12)))
    for _ in range(draw(st.integers(0, 2))):
        who = tuple(sorted(draw(st.sets(st.integers(0, nodes - 1), min_size=2))))
        segments.append((who, True))
    options = FloodOptions(draw(st.integers(1, 8)), draw(st.sampled_from([0.0, 0.005])))
    return World(nodes, segments, draw(st.sampled_from([0.0, 0.3, 0.9])), options, draw(st.integers(0, 999)))


@given(worlds(), st.integers(1, 5))
def test_at_most_one_delivery_and_one_transmission_each(world: World, frames: int) -> None:
    texts = {world.originate(0, text=bytes([number])) for number in range(frames)}
    world.run()
    assert max(world.delivered.values(), default=1) == 1, f"seed {world.seed}"
    assert max(world.sent.values(), default=1) == 1, f"seed {world.seed}"
    assert {inner for _, inner in world.delivered} <= texts
    assert not any(node == 0 for node, _ in world.delivered), "nobody hears itself"


@given(worlds())
def test_without_loss_it_comes_as_far_as_hops_lead(world: World) -> None:
    world.loss_ratio = 0.0
    inner = world.originate(0)
    world.run()
    reached, new = {0}, {0}
    while new:
        new = {b for who, _ in world.segments for a in who if a in new for b in who} - reached
        reached |= new
    got = {node for node, what in world.delivered if what == inner}
    assert got <= reached - {0}
    if world.options.hop_limit >= world.nodes - 1:
        assert got == reached - {0}, f"seed {world.seed}"


def test_a_frame_for_one_node_arrives_there_alone_and_stops_there() -> None:
    world = World(4, LINE)
    inner = world.originate(0, to=mac(2))
    world.run()
    assert world.delivered == {(2, inner): 1}
    assert set(world.sent) == {(0, 0, 1), (1, 1, 1)}, "neither back nor beyond"


def test_both_ways_round_a_diamond_and_one_delivery() -> None:
    world = World(4, DIAMOND)
    inner = world.originate(0)
    world.run()
    assert world.delivered == {(node, inner): 1 for node in (1, 2, 3)}
    assert world.flooders[3].counts["duplicate"] == 1


def test_on_a_radio_it_goes_out_again_where_it_came_from() -> None:
    world = World(3, [((0, 1, 2), True)])
    world.originate(0)
    world.run()
    assert set(world.sent) == {(0, 0, 1), (1, 0, 1), (2, 0, 1)}


def test_the_hop_limit_ends_it() -> None:
    world = World(4, LINE, options=FloodOptions(hop_limit=2))
    inner = world.originate(0)
    world.run()
    assert set(world.delivered) == {(1, inner), (2, inner)}
    assert world.flooders[2].counts["hop_limit"] == 1


def frame_of(sequence: int, *, to: bytes = GROUP, hop_limit: int = 9) -> bytes:
    inner = to + mac(9) + b"\x08\x00"
    return GROUP + mac(9) + encode(Header(hop_limit, len(inner), mac(9), 0, sequence), inner)


def relay(*, is_radio: bool, jitter_s: float = 0.01, seed: int = 1) -> Flooder:
    members = [Member(b"\2wire0", False), Member(b"\2membr", is_radio)]
    return Flooder(mac(1), members, FloodOptions(8, jitter_s), epoch=0, rng=random.Random(seed))


def test_a_wire_is_served_at_once_and_a_radio_after_a_random_time_in_order() -> None:
    wire, radio = relay(is_radio=False), relay(is_radio=True)
    frames = [frame_of(sequence) for sequence in range(50)]
    for flooder in (wire, radio):
        for frame in frames:
            flooder.receive(0, frame, now=5.0)
    assert wire.next_due() == 5.0
    assert [decode(frame)[4] for _, frame in wire.due(now=5.0)] == list(range(50))
    assert wire.next_due() is None
    assert radio.due(now=5.0) == []
    due = radio.next_due()
    assert due is not None
    assert 5.0 < due < 5.01
    assert [decode(frame)[4] for _, frame in radio.due(now=5.01)] == list(range(50))


def test_the_jitter_is_uniform_and_the_seed_s() -> None:
    waits: list[float] = []
    for seed in range(400):
        flooder = relay(is_radio=True, seed=seed)
        flooder.receive(0, frame_of(1), now=0.0)
        due = flooder.next_due()
        assert due is not None
        waits.append(due)
    assert sum(waits) / 400 == pytest.approx(0.005, rel=0.1)
    assert (min(waits) < 0.0005, max(waits) > 0.0095, max(waits) <= 0.01) == (True, True, True)
    flooder.receive(0, frame_of(2), now=0.0)
    again = relay(is_radio=True, seed=399)
    again.receive(0, frame_of(1), now=0.0)
    assert again.next_due() == waits[-1]


def test_waiting_frames_are_bounded() -> None:
    flooder = relay(is_radio=True)
    for sequence in range(QUEUE_LIMIT + 3):
        flooder.receive(0, frame_of(sequence), now=0.0)
    assert flooder.counts["queue_full"] == 3
    assert len(flooder.due(now=1.0)) == QUEUE_LIMIT


def test_every_frame_is_counted_for_what_became_of_it() -> None:
    flooder = relay(is_radio=False)
    flooder.originate(GROUP + mac(1) + b"\x08\x00")
    own = GROUP + mac(9) + encode(Header(9, 14, mac(1), 0, 1), GROUP + mac(1) + b"\x08\x00")
    for frame in (frame_of(1), frame_of(1), frame_of(2, to=mac(1)), frame_of(3, to=mac(7)), own, b"junk"):
        flooder.receive(0, frame, now=0.0)
    flooder.due(now=0.0)
    flooder.count(Count.NOT_SENT)
    told = {name: number for name, number in flooder.counts.items() if number}
    expected = {"originated": 2, "relayed": 2, "delivered": 2, "duplicate": 1, "own": 1, "not_sent": 1, "too_short": 1}
    assert told == expected
    assert flooder.counts.keys() == {*Count, *Fault}


def test_padding_does_not_reach_the_mesh_interface() -> None:
    flooder = relay(is_radio=False)
    assert flooder.receive(0, frame_of(1) + bytes(20), now=0.0) == frame_of(1)[32:]


@given(st.binary(max_size=90), st.integers(0, 1))
def test_any_bytes_are_survived(data: bytes, member: int) -> None:
    flooder = relay(is_radio=True)
    frame = GROUP + mac(3) + b"\x88\xb5" + data
    assert flooder.receive(member, frame, now=0.0) is None or isinstance(decode(frame), Header)
