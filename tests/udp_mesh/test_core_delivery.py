"""What holds whatever the network does: delivered at most once, acknowledged means delivered, memory bounded."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from udp_mesh.core import events, wire
from udp_mesh.core.mesh import Path, Refused

RELAXED = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])


def pair(make_net: Any, seed: int = 1, **link: float) -> Any:
    net = make_net(seed=seed, **link)
    net.add("a")
    net.add("b")
    net.meet()
    return net


@pytest.mark.parametrize(
    ("size_bytes", "fragments"), [(0, 1), (1, 1), (1361, 1), (1362, 2), (2724, 2), (2725, 3), (100_000, 74)]
)
def test_a_message_of_any_size_arrives_as_it_was(make_net: Any, size_bytes: int, fragments: int) -> None:
    net = pair(make_net)
    payload = bytes(net.rng.randbytes(size_bytes))
    net.publish("a", "t", payload, "b", priority=7)
    net.run(1.0)
    (message,) = net.delivered("b")
    assert (message.payload, message.topic, message.priority, message.source) == (payload, "t", 7, "a")
    assert len(net.of("a", events.MessageAcked)) == 1
    assert net.of("a", events.MessageQueued)[0].fragment_count == fragments


def test_nothing_of_a_burst_is_overlooked(make_net: Any) -> None:
    net = pair(make_net)
    before = net.cores["b"].stats()["datagrams_received"]
    for number in range(3):
        net.publish("a", "t", bytes(100_000 + number), "b")
    net.run(0.5)
    assert len(net.delivered("b")) == 3
    assert "fragments_retransmitted" not in net.cores["a"].stats()
    assert net.cores["b"].stats()["datagrams_received"] - before >= 3 * 74


def test_no_datagram_is_longer_than_set_and_bulk_fills_them(make_net: Any) -> None:
    net = make_net()
    net.keep_datagrams = True
    net.add("a", payload_bytes=700)
    net.add("b")
    net.meet()
    net.publish("a", "t", bytes(50_000), "b")
    net.run(1.0)
    sizes = [len(datagram.data) for _at, datagram in net.sent["a"]]
    assert max(sizes) == 700
    assert sizes.count(700) >= 70


@given(
    seed=st.integers(0, 1 << 32),
    loss=st.floats(0, 0.4),
    duplicates=st.floats(0, 0.3),
    jitter_s=st.floats(0, 0.05),
    restart=st.sampled_from(["", "a", "b"]),
    sizes=st.lists(st.integers(0, 6000), min_size=1, max_size=12),
)
@RELAXED
def test_delivered_at_most_once_and_acknowledged_means_delivered(
    make_net: Any, seed: int, loss: float, duplicates: float, jitter_s: float, restart: str, sizes: list[int]
) -> None:
    net = pair(make_net, seed)
    net.link("a", "b", loss_ratio=loss, duplicate_ratio=duplicates, jitter_s=jitter_s)
    published: dict[tuple[int, int], bytes] = {}  # (epoch, id) -> payload
    for number, size in enumerate(sizes):
        payload = number.to_bytes(2, "big") + bytes(size)
        to = "all" if number % 4 == 3 else "b"
        with contextlib.suppress(Refused):  # with much loss the peer may be held offline
            published[net.cores["a"].epoch, net.publish("a", "t", payload, to, priority=number % 3)] = payload
        if number == len(sizes) // 2 and restart:
            net.run(0.02)
            net.stop(restart)
            net.add(restart)
            net.run(3.0, until=lambda: all(any(p.online for p in c.peers(now=net.now)) for c in net.cores.values()))
    net.run(20.0)
    payloads = [message.payload for message in net.delivered("b")]
    if restart != "b":  # one epoch of the receiver: nothing twice
        assert len(payloads) == len(set(payloads))
    assert set(payloads) <= set(published.values())
    if restart != "a":
        epoch = net.cores["a"].epoch
        acked = {published[epoch, event.message_id] for event in net.of("a", events.MessageAcked)}
        assert acked <= set(payloads)
        unknown = {e.message_id for e in net.of("a", events.MessageDropped)}
        reliable = {e.message_id for e in net.of("a", events.MessageQueued) if e.peer == "b"}
        settled = {e.message_id for e in net.of("a", events.MessageAcked)} | unknown
        assert reliable <= settled, "every reliable message ends acknowledged or dropped with a reason"
        assert net.cores["a"].stats()["queued_bytes"] == 0


@given(datagrams=st.lists(st.binary(max_size=100), max_size=20), seed=st.integers(0, 1000))
@RELAXED
def test_foreign_and_damaged_datagrams_change_nothing(make_net: Any, datagrams: list[bytes], seed: int) -> None:
    net = pair(make_net, seed)
    core = net.cores["b"]
    header = wire.encode_header(
        epoch=net.cores["a"].epoch, destination_tag=wire.tag_of(core.epoch), packet_number=500, flags=0
    )
    for data in datagrams:
        core.receive_datagram(data, Path(0, "somewhere"), now=net.now)
        core.receive_datagram(header + b"\xff" + data, Path(0, "a"), now=net.now)
    assert sum(count for name, count in core.stats().items() if name.startswith("bad_")) == 2 * len(datagrams)
    net.publish("a", "t", b"still works", "b")
    net.run(1.0)
    assert [message.payload for message in net.delivered("b")] == [b"still works"]


@given(frames=st.lists(st.integers(0, 0xFFFE), min_size=1, max_size=60), seed=st.integers(0, 1000))
@RELAXED
def test_a_peer_that_sends_nonsense_fragments_reserves_bounded_memory(
    make_net: Any, frames: list[int], seed: int
) -> None:
    net = make_net(seed=seed)
    net.add("a")
    net.add("b", reassembly_bytes=100_000)
    net.meet()
    core = net.cores["b"]
    for number, count in enumerate(frames):
        header = wire.encode_header(
            epoch=net.cores["a"].epoch, destination_tag=wire.tag_of(core.epoch), packet_number=1000 + number, flags=0
        )
        data = wire.encode_data_header(message_id=number, priority=1, index=count, count=count + 1, payload_bytes=9)
        if count > 0:
            core.receive_datagram(header + data + bytes(9), Path(0, "a"), now=net.now)
        assert core.stats()["reassembly_bytes"] <= 100_000


def test_a_fragment_without_room_is_not_acknowledged(make_net: Any) -> None:
    net = make_net()
    net.add("a")
    net.add("b", reassembly_bytes=10_000)
    net.meet()
    net.publish("a", "t", bytes(50_000), "b")
    net.run(3.0)
    assert net.delivered("b") == []
    assert net.of("a", events.MessageAcked) == []
    assert net.cores["b"].stats()["fragments_no_memory"] > 0


def test_stale_partials_are_purged_and_the_message_starts_over(make_net: Any) -> None:
    net = pair(make_net, delay_s=0.005)
    net.link("a", "b", rate_bps=1e6)
    net.publish("a", "slow", bytes(60_000), "b", priority=9)
    net.run(0.1)
    # Urgent traffic takes the whole link for longer than a partial message is kept without news.
    net.every(0.01, lambda: net.publish("a", "urgent", bytes(1300), "b", priority=1), until_s=net.now + 35)
    net.run(36.0)
    assert len(net.of("b", events.PartialPurged)) == 1
    net.run(20.0)
    assert [len(message.payload) for message in net.delivered("b", "slow")] == [60_000]
    assert net.cores["b"].stats()["reassembly_bytes"] == 0


def test_broadcast_is_one_datagram_and_large_goes_to_every_online_peer(make_net: Any) -> None:
    net = make_net()
    net.keep_datagrams = True
    for name in ("a", "b", "c"):
        net.add(name)
    net.meet()
    net.run(0.3)
    before = len(net.sent["a"])
    net.publish("a", "small", b"x" * 100, "all")
    net.run(0.0)
    assert [datagram.path.address for _at, datagram in net.sent["a"][before:]] == [""]
    net.publish("a", "large", b"y" * 10_000, "all")
    net.run(1.0)
    for name in ("b", "c"):
        assert [message.topic for message in net.delivered(name)] == ["small", "large"]
    acked = net.of("a", events.MessageAcked)
    assert {event.peer for event in acked} == {"b", "c"}
    assert len({event.message_id for event in acked}) == 1


def test_a_lost_acknowledgement_delivers_nothing_twice(make_net: Any) -> None:
    net = pair(make_net)
    net.one_way("b", "a", is_cut=True)
    net.publish("a", "t", b"once", "b")
    net.run(0.3)
    net.one_way("b", "a", is_cut=False)
    net.run(2.0)
    assert len(net.delivered("b")) == 1
    assert len(net.of("a", events.MessageAcked)) == 1
    assert net.cores["a"].stats()["fragments_retransmitted"] > 0


def test_a_repeated_packet_is_recognised_before_its_content(make_net: Any) -> None:
    net = pair(make_net)
    net.link("a", "b", duplicate_ratio=1.0)
    net.publish("a", "t", bytes(20_000), "b")
    net.run(1.0)
    stats = net.cores["b"].stats()
    assert len(net.delivered("b")) == 1
    assert stats["duplicate_packets"] >= 15
    assert "fragments_duplicate" not in stats
