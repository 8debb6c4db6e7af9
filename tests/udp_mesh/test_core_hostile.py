"""Whatever comes from the network, no exception reaches the loop, memory stays bounded, and honest peers are served."""

from __future__ import annotations

from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from udp_mesh.core import wire
from udp_mesh.core.mesh import Path

RELAXED = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
ids = st.one_of(st.integers(0, 200), st.integers(0, (1 << 48) - 1))
names = st.sampled_from(["a", "b", "c", "mallory", "all", "x" * 63])
tags = st.lists(st.integers(0, (1 << 32) - 1), max_size=255)


@st.composite
def ack(draw: st.DrawFn) -> bytes:
    largest = draw(ids)
    first = draw(st.integers(max(0, largest - 70_000), largest))
    ranges = [(first, largest)]
    for _ in range(draw(st.integers(0, 5))):
        end = ranges[-1][0] - draw(st.integers(2, 300))
        if end < 0:
            break
        ranges.append((max(0, end - draw(st.integers(0, 300))), end))
    received_us, delay_us = draw(st.integers(0, (1 << 32) - 1)), draw(st.integers(0, (1 << 32) - 1))
    return wire.encode_ack(ranges, received_us=received_us, delay_us=delay_us, room_bytes=1000)


@st.composite
def data(draw: st.DrawFn) -> bytes:
    count = draw(st.sampled_from([1, 2, 3, 100, 65535]))
    index = draw(st.sampled_from([0, count - 1, count // 2]))
    payload = bytes(draw(st.sampled_from([0, 1, 9, 100])))
    topic = draw(st.sampled_from([b"t", b"udp_mesh/confirm", "\N{SNOWMAN}".encode(), b"x" * 255]))
    head = wire.encode_data_header(
        message_id=draw(ids),
        priority=draw(st.integers(0, 255)),
        index=index,
        count=count,
        payload_bytes=len(payload),
        topic=topic,
        flags=draw(st.integers(0, 1)),
    )
    return head + payload


frame = st.one_of(
    ack(),
    data(),
    data(),
    st.builds(
        lambda name, interval_s, floor, heard: wire.encode_hello(
            name=name, beacon_interval_s=interval_s, floor=floor, heard=heard
        ),
        names,
        st.floats(0, 66),
        ids,
        tags,
    ),
    st.builds(wire.encode_probe, tags),
    st.builds(wire.encode_floor, ids),
    st.builds(wire.encode_purged, ids),
    st.just(wire.PING),
    st.binary(max_size=20),
)
packet = st.tuples(
    st.sampled_from(["a", "b", "stranger", "self"]),  # whose epoch it claims
    st.sampled_from(["us", "all", "other"]),
    ids,
    st.sampled_from([0, wire.FLAG_UNNUMBERED, wire.FLAG_ACK_NOW, 3]),
    st.lists(frame, max_size=4),
    st.integers(0, 3),  # how many times
)


@given(seed=st.integers(0, 1000), packets=st.lists(packet, max_size=25), waits_s=st.sampled_from([0.0, 0.01, 0.7]))
@RELAXED
def test_well_formed_nonsense_from_known_epochs_breaks_nothing(
    make_net: Any, seed: int, packets: list[Any], waits_s: float
) -> None:
    net = make_net(seed=seed)
    for name in ("a", "b", "c"):
        net.add(name, reassembly_bytes=300_000)
    net.meet()
    core = net.cores["c"]
    net.publish("c", "t", bytes(20_000), "a")
    for who, to, number, flags, frames, repeats in packets:
        epoch = {"stranger": 0x77_0000_0001, "self": core.epoch}.get(who) or net.cores[who].epoch
        tag = {"us": wire.tag_of(core.epoch), "all": 0, "other": 5}[to]
        header = wire.encode_header(epoch=epoch, destination_tag=tag, packet_number=number, flags=flags)
        for _ in range(repeats):
            core.receive_datagram(header + b"".join(frames), Path(0, "a"), now=net.now)
        net.run(waits_s)
        assert core.stats()["reassembly_bytes"] <= 300_000
    net.run(3.0)
    assert len(core.peers(now=net.now)) <= 5


@given(seed=st.integers(0, 1000), choices=st.data())
@RELAXED
def test_a_conversation_with_flipped_cut_and_joined_bytes_stays_sound(
    make_net: Any, seed: int, choices: st.DataObject
) -> None:
    net = make_net(seed=seed)
    net.keep_datagrams = True
    net.add("a")
    net.add("b")
    net.meet()
    net.publish("a", "t", bytes(8000), "b")
    net.run(0.5)
    real = [datagram.data for _at, datagram in net.sent["a"]]
    for _ in range(choices.draw(st.integers(1, 15))):
        damaged = bytearray(choices.draw(st.sampled_from(real)))
        for _flip in range(choices.draw(st.integers(0, 3))):
            damaged[choices.draw(st.integers(0, len(damaged) - 1))] = choices.draw(st.integers(0, 255))
        cut = choices.draw(st.integers(0, len(damaged)))
        joined = bytes(damaged[:cut]) + choices.draw(st.sampled_from([b"", real[0], real[-1]]))
        segment_bytes = choices.draw(st.integers(1, 1500))
        net.cores["b"].receive_burst(joined, segment_bytes, Path(0, "a"), now=net.now)
        net.run(0.01)
    net.run(1.0)
    assert net.cores["b"].stats()["datagrams_received"] > 0
