"""What udp_mesh makes of a radio channel, where acknowledgements and data take turns; over the lab's own channel."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.medium.verdicts import Verdict
from tests.udp_mesh.radio_net import HEADERS, bring_together, shared_channel
from udp_mesh.core import events

CONTACT_S = 3.0
PAYLOAD_BYTES = 1400
SEEDS = range(1, 6)


def blind_bytes(seed: int) -> int:
    """UDP payload that arrives of a sender that never pauses, in one contact."""
    channel = shared_channel(("base", "robot"), seed=seed, rate_bps=6e6)
    bring_together(channel, 2, near=True)
    frame = HEADERS + bytes(PAYLOAD_BYTES)
    for _ in range(2):
        channel.offer(1, frame, 0, now=0.0)
    received = 0
    while (at_s := channel.next_event()) is not None and at_s <= CONTACT_S:
        for decided in channel.advance(at_s):
            received += decided.fates[0][1] is Verdict.DELIVERED
            channel.offer(1, frame, 0, now=at_s)
    return received * PAYLOAD_BYTES


def hand_over(net: Any) -> int:
    """Let the robot have a backlog for the base when they meet, for the time of a contact; return what arrives."""
    before = len(net.delivered("base"))

    def pass_on() -> None:
        for topic, count, size_bytes, priority in (("artifact", 16, 2_000, 1), ("map", 100, 20_000, 7)):
            for _ in range(count):
                net.publish("robot", topic, bytes(size_bytes), "base", priority=priority)

    def met() -> bool:
        return bool(net.cores["robot"].is_online("base"))

    end_s = net.now + CONTACT_S
    net.bring_together(near=True)
    assert net.run(CONTACT_S, until=met)
    pass_on()
    net.run(end_s - net.now)
    net.bring_together(near=False)
    net.run(0.5)
    return sum(len(message.payload) for message in net.delivered("base")[before:])


def alone(radio: Any, seed: int) -> Any:
    """A base and a robot that have beaconed in vain for a while."""
    net = radio("base", "robot", seed=seed)
    for name in net.names:
        net.add(name)
    net.run(2.0 + net.rng.random())
    return net


@pytest.mark.parametrize("seed", SEEDS)
def test_a_first_meeting_of_seconds_is_used(radio: Any, seed: int) -> None:
    share = hand_over(alone(radio, seed)) / blind_bytes(seed)
    print(f"seed {seed}: {share:.1%}")
    assert share >= 0.75


@pytest.mark.parametrize("seed", SEEDS)
def test_a_later_meeting_of_seconds_is_used_still_better(radio: Any, seed: int) -> None:
    net = alone(radio, seed)
    net.bring_together(near=True)
    net.run(0.5)
    for _ in range(40):
        net.publish("robot", "map", bytes(20_000), "base", priority=7)
    net.run(3.0)
    net.bring_together(near=False)
    net.run(4.0 + net.rng.random())
    net.cores["robot"].seek("base", now=net.now)
    assert not net.cores["robot"].is_online("base")
    share = hand_over(net) / blind_bytes(seed)
    print(f"seed {seed}: {share:.1%}")
    assert share >= 0.87
    topics = [message.topic for message in net.delivered("base")[40:]]
    assert topics[:16] == ["artifact"] * 16, "the most urgent first"


def saturated(radio: Any, *, seed: int, rate_bps: float) -> tuple[Any, dict[int, float]]:
    """Bulk for four seconds beside telemetry at 10 Hz; returns when that was published."""
    net = radio("base", "robot", seed=seed, rate_bps=rate_bps)
    net.bring_together(near=True)
    for name in net.names:
        net.add(name)
    net.meet()
    net.run(1.0)
    end_s, published = net.now + 4.0, {}

    def bulk() -> None:
        while net.cores["robot"].stats()["queued_bytes"] < 200_000:
            net.publish("robot", "map", bytes(20_000), "base", priority=9)

    def telemetry() -> None:
        published[net.publish("robot", "telemetry", bytes(200), "base", priority=1)] = net.now

    net.every(0.01, bulk, until_s=end_s)
    net.every(0.0973, telemetry, until_s=end_s)
    net.run(2.0)
    net.keep_datagrams = True
    net.run(2.0)
    return net, published


@pytest.mark.parametrize(("rate_bps", "least_bps"), [(6e6, 4.6e6), (24e6, 15e6)])
def test_acknowledgements_leave_the_channel_to_data_and_nothing_waits(
    radio: Any, rate_bps: float, least_bps: float
) -> None:
    net, published = saturated(radio, seed=1, rate_bps=rate_bps)
    data = sum(bool(packet.fragments) for _at, packet in net.packets("robot"))
    acks = sum(bool(packet.acks) for _at, packet in net.packets("base"))
    assert acks < data / 3
    maps = [message for message in net.delivered("base", "map") if message.now >= net.now - 2.0]
    assert len(maps) * 20_000 * 8 / 2.0 >= least_bps
    latencies = sorted(m.now - published[m.message_id] for m in net.delivered("base", "telemetry"))
    assert len(latencies) >= 40
    assert latencies[len(latencies) // 2] < 2.5 * 8 * 1500 / rate_bps + 0.001
    assert latencies[-1] < 0.03


def test_nothing_is_lost_or_sent_twice_for_want_of_an_acknowledgement(radio: Any) -> None:
    net, _published = saturated(radio, seed=2, rate_bps=6e6)
    net.run(1.0)
    stats = net.cores["robot"].stats()
    assert stats["spurious_losses"] == 0
    assert stats.get("fragments_retransmitted", 0) <= 2, "a probe at most"
    assert not net.of("robot", events.MessageDropped)


def test_on_a_wire_acknowledgements_come_as_they_always_did(make_net: Any) -> None:
    net = make_net(seed=3, delay_s=0.02)
    net.add("a")
    net.add("b")
    net.meet()
    net.link("a", "b", rate_bps=10e6, limit_packets=50)
    net.keep_datagrams = True
    net.publish("a", "bulk", bytes(1_500_000), "b")
    assert net.run(3.0, until=lambda: len(net.delivered("b")) == 1)
    assert not any(packet.ack_later for _at, packet in net.packets("a"))
