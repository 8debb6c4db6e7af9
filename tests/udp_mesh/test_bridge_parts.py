"""The parts of a bridge one by one: its queue, what it tells, what it refuses, and what others make of it."""

from __future__ import annotations

from random import Random

import pytest

from udp_mesh.core import wire
from udp_mesh.core.beacons import Beacons
from udp_mesh.core.bridge import Bridge
from udp_mesh.core.bridge_queue import LEAST_QUEUE_BYTES, MAX_WAIT_S, QUEUE_S, BridgeQueue
from udp_mesh.core.broadcasts import Broadcasts
from udp_mesh.core.carriers import UNLIMITED_BYTES, Carrier, Path
from udp_mesh.core.datagram import Datagram
from udp_mesh.core.links import LEAST_MTU_BYTES, MOST_GREETINGS, RAREST_INTERVAL_S, Links
from udp_mesh.core.packets import Link
from udp_mesh.core.paths import Paths
from udp_mesh.core.peer import Peer, Session
from udp_mesh.core.settings import Settings
from udp_mesh.core.state import NodeState

FAST, SLOW = 0, 1


def datagram(priority: int, size: int = 100) -> Datagram:
    return Datagram(Path(SLOW, "x"), bytes([priority]) * size, 0, priority)


def node(name: str = "m") -> NodeState:
    state = NodeState(Settings(name=name, bridge=True), epoch=1 << 32 | 1, rng=Random(1))
    state.carriers = {FAST: Carrier(FAST), SLOW: Carrier(SLOW, 244, 5000.0)}
    return state


def peer(state: NodeState, tag: int, path: Path, *, name: str = "") -> Peer:
    """Make a peer known that was heard just now, at time 0."""
    name = name or f"peer{tag}"
    made = Peer(name, Session(1 << 40 | tag, state.memory, now=0.0), path, state.new_congestion(path, now=0.0), now=0.0)
    made.is_online = True
    made.paths.heard(path, now=0.0)
    state.peers[name] = state.by_epoch[made.session.epoch] = made
    return made


def test_the_queue_hands_out_the_most_urgent_and_within_it_the_oldest() -> None:
    queue = BridgeQueue(5000.0)
    for at, priority in enumerate((9, 1, 9, 1, 5)):
        assert queue.push(datagram(priority, size=100 + at), now=float(at)) == 0
    out = []
    while queue.head_priority is not None:
        out.append(queue.pop())
    assert [(d.priority, len(d.data)) for d in out] == [(1, 101), (1, 103), (5, 104), (9, 100), (9, 102)]
    assert queue.waiting_bytes == 0


def test_the_queue_is_bounded_and_loses_the_oldest_of_the_least_urgent() -> None:
    queue = BridgeQueue(5000.0)
    assert queue.limit_bytes == LEAST_QUEUE_BYTES
    assert BridgeQueue(1e6).limit_bytes == QUEUE_S * 1e6 / 8
    queue.push(datagram(9, size=96), now=0.0)
    dropped = sum(queue.push(datagram(3, size=200), now=1.0) for _ in range(20))
    assert dropped == 0
    assert queue.push(datagram(1, size=200), now=2.0) == 2  # 296 bytes have to go: that of 9, and the first of 3
    assert queue.waiting_bytes <= LEAST_QUEUE_BYTES
    assert queue.forget_stale(now=1.0 + MAX_WAIT_S) == 0
    assert queue.forget_stale(now=1.5 + MAX_WAIT_S) == 19
    assert queue.pop().priority == 1


def test_on_a_slow_carrier_tags_take_turns_and_all_are_told_within_the_rounds() -> None:
    state = node()
    bridge = Bridge(state, Links(state))
    for tag in range(10, 40):
        peer(state, tag, Path(FAST, f"a{tag}"))
    peer(state, 99, Path(SLOW, "s"))
    told: list[int] = []
    rounds = 0
    while rounds == 0 or len(told) < 30:
        frames = bridge.link_frames(SLOW, 1000, now=0.0)
        assert len(frames) <= 64
        (link,) = dissected(frames)
        assert (link.mtu_bytes, link.rate_bps) == (UNLIMITED_BYTES, 0)
        told += link.tags
        rounds = rounds or link.rounds
    assert sorted(set(told)) == list(range(10, 40))
    assert rounds == -(-30 // 13)
    (fast,) = dissected(bridge.link_frames(FAST, 1000, now=0.0))
    assert fast[1:] == (244, 5000, 1, (99,))
    assert bridge.link_frames(FAST, 13, now=0.0) == b""  # no room for a single one


def dissected(frames: bytes) -> tuple[Link, ...]:
    header = wire.encode_header(epoch=5, destination_tag=0, packet_number=0, flags=wire.FLAG_UNNUMBERED)
    packet = wire.dissect(header + frames)
    assert packet is not None
    return packet.links


def test_who_is_heard_on_a_carrier_is_not_told_of_there() -> None:
    state = node()
    bridge = Bridge(state, Links(state))
    both = peer(state, 7, Path(FAST, "a"))
    both.paths.heard(Path(SLOW, "s"), now=0.0)
    assert bridge.link_frames(SLOW, 1000, now=1.0) == b""
    assert dissected(bridge.link_frames(SLOW, 1000, now=10.0))[0].tags == (7,)


@pytest.mark.parametrize(
    ("flags", "target", "is_passed"),
    [(0, 7, True), (wire.FLAG_BRIDGED, 7, False), (0, 8, False), (0, 12345, False), (0, 9, False)],
    ids=["other carrier", "bridged before", "same carrier", "unknown", "itself behind a bridge"],
)
def test_what_is_passed_on(flags: int, target: int, is_passed: bool) -> None:
    state = node()
    state.links[1] = Carrier(1)
    bridge = Bridge(state, Links(state))
    sender = peer(state, 6, Path(FAST, "a"))
    peer(state, 7, Path(SLOW, "s"))
    peer(state, 8, Path(FAST, "b"))
    peer(state, 9, Path(SLOW, "s", 1))
    data = (
        wire.encode_header(epoch=sender.session.epoch, destination_tag=target, packet_number=0, flags=flags) + wire.PING
    )
    packet = wire.dissect(data)
    assert packet is not None
    assert bridge.unicast(data, packet, sender, sender.path, now=0.0) == is_passed
    out = bridge.datagrams(lambda _carrier: None, now=0.0)
    assert [d.path for d in out] == ([Path(SLOW, "s")] if is_passed else [])
    assert all(packet.is_bridged for d in out if (packet := wire.dissect(d.data)))


def test_a_link_greets_strangers_ever_more_seldom_and_few_at_a_time() -> None:
    state = node()
    links = Links(state)
    bridge = peer(state, 2, Path(FAST, "b"))
    greeted: list[tuple[float, int]] = []

    def take(tags: tuple[int, ...], path: Path, now: float) -> None:
        links.take(bridge, Link(0, 244, 5000, 1, tags), path, lambda tag, _way: greeted.append((now, tag)), now=now)

    for now in range(200):
        take((state.tag, 50), Path(FAST, "b"), float(now))
    assert {tag for _at, tag in greeted} == {50}  # never itself
    assert [at for at, _tag in greeted] == [0, 1, 3, 7, 15, 31, 63, 123, 183]
    assert RAREST_INTERVAL_S == 60
    links.met(50)
    take((50,), Path(FAST, "b"), 184.0)
    assert greeted[-1] == (184.0, 50)
    greeted.clear()
    take(tuple(range(100, 200)), Path(FAST, "b"), 300.0)
    assert len(greeted) == MOST_GREETINGS
    greeted.clear()
    take(tuple(range(200, 300)), Path(SLOW, "b"), 300.0)
    assert len(greeted) == 1


def test_a_link_that_has_changed_is_another_one_and_a_tiny_one_is_none() -> None:
    state = node()
    links = Links(state)
    bridge = peer(state, 2, Path(FAST, "b"))
    way = {}
    for link in (Link(0, 244, 5000, 1, (50,)), Link(0, 1400, 0, 1, (50,)), Link(1, LEAST_MTU_BYTES - 1, 0, 1, (51,))):
        links.take(bridge, link, bridge.path, lambda _tag, _way: None, now=0.0)
        for tag in link.tags:
            told = links.way(tag, bridge.path)
            way[link.mtu_bytes] = None if told is None else told.way
    assert state.packet_bytes(way[244] or bridge.path) == 244
    assert state.packet_bytes(way[1400] or bridge.path) == 1400
    assert way[244] != way[1400]
    assert way[LEAST_MTU_BYTES - 1] is None
    assert links.way(50, Path(FAST, "somebody else")) is None


def test_own_messages_take_turns_with_passed_on_ones_of_their_priority() -> None:
    state = node()
    bridge = Bridge(state, Links(state))
    sender = peer(state, 6, Path(FAST, "a"))
    peer(state, 7, Path(SLOW, "s"))
    data = wire.encode_header(epoch=sender.session.epoch, destination_tag=7, packet_number=0, flags=0)
    data += wire.encode_data_header(message_id=1, priority=5, index=0, count=1, payload_bytes=0, topic=b"t")
    packet = wire.dissect(data)
    assert packet is not None
    for _ in range(6):
        bridge.unicast(data, packet, sender, sender.path, now=0.0)
    counts = [len(bridge.datagrams(lambda _carrier: 5, now=float(now))) for now in range(6)]
    assert counts == [1, 0, 1, 0, 1, 0]
    assert bridge.datagrams(lambda _carrier: 4, now=10.0) == []
    assert len(bridge.datagrams(lambda _carrier: 6, now=10.0)) == 1
    assert bridge.datagrams(lambda _carrier: 6, now=10.0) == []  # the line is busy
    assert bridge.next_timer(now=10.0) == state.carriers[SLOW].busy_until_s > 10.0


def test_what_goes_over_a_link_is_charged_to_it_and_to_the_carrier_before_it() -> None:
    state = node()
    state.links[1] = Carrier(1, 244, 5000.0)
    state.charge(Path(FAST, "b", 1), 250, now=1.0)
    assert state.free_at_s(Path(FAST, "other", 1)) == pytest.approx(1.4)
    assert state.free_at_s(Path(FAST, "b")) < 1.0
    state.charge(Path(SLOW, "b", 1), 250, now=2.0)
    assert state.free_at_s(Path(SLOW, "b")) == state.free_at_s(Path(FAST, "b", 1)) == pytest.approx(2.4)


def test_who_is_behind_a_bridge_sends_no_beacons_here_and_does_not_count() -> None:
    state = node()
    beacons = Beacons(state, Broadcasts(state), now=0.0)
    state.links[1] = Carrier(1)
    for tag in range(10, 210):
        peer(state, tag, Path(FAST, "b", 1))
    assert beacons.interval_s() == state.settings.beacon_interval_s
    for tag in range(210, 410):
        peer(state, tag, Path(FAST, f"a{tag}"))
    assert beacons.interval_s() > 2 * state.settings.beacon_interval_s


def test_a_direct_path_is_preferred_to_one_over_a_bridge_of_about_its_speed() -> None:
    links = {1: Carrier(1), 2: Carrier(2), 3: Carrier(3, 244, 5000.0)}
    carriers = {FAST: Carrier(FAST), SLOW: Carrier(SLOW, 244, 5000.0)}
    direct, bridged, serial = Path(FAST, "a"), Path(FAST, "bridge", 1), Path(SLOW, "s")
    paths = Paths(links)
    for path in (bridged, direct):
        paths.heard(path, now=0.0).loss_ratio = 0.5 if path == direct else 0.0
    assert paths.best(bridged, carriers, stale_s=1.0, now=0.0) == direct
    assert paths.best(direct, carriers, stale_s=1.0, now=0.0) == direct
    assert paths.alternative(direct, carriers, stale_s=1.0, now=0.0) is None  # for one late answer
    paths.heard(bridged, now=5.0)
    assert paths.best(direct, carriers, stale_s=1.0, now=5.0) == bridged
    slow = Paths(links)
    for path in (serial, bridged, Path(FAST, "other", 2)):
        slow.heard(path, now=0.0)
    assert slow.best(serial, carriers, stale_s=1.0, now=0.0) == bridged  # much faster
    slow.heard(Path(FAST, "bridge", 3), now=0.0)  # behind the same bridge is another link now
    assert [known.path for known in slow] == [serial, Path(FAST, "other", 2), Path(FAST, "bridge", 3)]
