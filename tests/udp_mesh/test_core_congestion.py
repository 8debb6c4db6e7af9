"""How the window follows a path: a queue of about a packet, whatever the rate, and whatever else delays packets."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from udp_mesh.core.congestion import AckSample
from udp_mesh.core.delay_control import MIN_DATAGRAM_BYTES, DelayControl
from udp_mesh.core.pacer import Pacer
from udp_mesh.core.rtt import RttEstimator

PACKET = 1400


def saturated(make_net: Any, *, seed: int = 3, rate_bps: float = 10e6, **settings: object) -> Any:
    """Nodes a and b and a link that bulk keeps busy; ``sent`` are the telemetry messages, by id."""
    net = make_net(seed=seed, delay_s=0.02)
    net.add("a", **settings)
    net.add("b", **settings)
    net.meet()
    net.link("a", "b", rate_bps=rate_bps, limit_packets=200)
    net.telemetry = {}

    def bulk() -> None:
        while net.cores["a"].stats()["queued_bytes"] < 600_000:
            net.publish("a", "bulk", bytes(20_000), "b", priority=9)

    def telemetry() -> None:
        net.telemetry[net.publish("a", "telemetry", bytes(200), "b", priority=1)] = net.now

    net.every(0.02, bulk, until_s=1e9)
    net.every(0.0437, telemetry, until_s=1e9)
    return net


def latencies(net: Any, since_s: float) -> list[float]:
    published = net.telemetry
    return sorted(
        m.now - published[m.message_id] for m in net.delivered("b", "telemetry") if published[m.message_id] >= since_s
    )


def bulk_bps(net: Any, since_s: float) -> float:
    return sum(8 * len(m.payload) for m in net.delivered("b", "bulk") if m.now >= since_s) / (net.now - since_s)


def test_the_standing_queue_never_passes_for_the_path(make_net: Any) -> None:
    """Delays older than 10 s are forgotten: a queue that never runs empty would grow by its own length each time."""
    net = saturated(make_net, rate_bps=3e6)
    net.run(26.0)
    late = latencies(net, net.now - 6.0)
    assert late[len(late) // 2] < 0.02 + 2.2 * 8 * 1442 / 3e6
    assert bulk_bps(net, net.now - 6.0) > 0.9 * 3e6 * 1363 / 1442


@pytest.mark.parametrize("rate_bps", [2e6, 40e6])
def test_another_rate_is_found_within_seconds(make_net: Any, rate_bps: float) -> None:
    net = saturated(make_net)
    net.run(2.0)
    net.one_way("a", "b", rate_bps=rate_bps)
    net.run(2.0)
    settled_s = net.now
    net.run(2.5)
    assert bulk_bps(net, settled_s) > 0.8 * rate_bps * 1363 / 1442
    assert latencies(net, settled_s)[-1] < 0.02 + max(0.004, 4 * 8 * 1442 / rate_bps)


def test_jitter_is_no_queue(make_net: Any) -> None:
    net = saturated(make_net)
    net.link("a", "b", jitter_s=0.004)
    net.run(4.0)
    assert bulk_bps(net, net.now - 3.0) > 0.8 * 10e6 * 1363 / 1442


def settled(*, cwnd_packets: int = 20) -> tuple[DelayControl, RttEstimator]:
    """A control that has left its start, on a path of 40 ms."""
    control, rtt = DelayControl(datagram_bytes=PACKET, now=0.0), RttEstimator()
    now = 0.0
    for number in range(400):
        now += 0.002
        rtt.update(0.04, ack_delay_s=0.0)
        delay_s = 0.02 if number < cwnd_packets else 0.0206 if number > 60 else 0.03
        control.on_ack(sample(delay_s, now=now), rtt=rtt, now=now)
    return control, rtt


def sample(one_way_s: float, *, now: float, size: int = PACKET) -> AckSample:
    return AckSample(
        acked_bytes=2 * size,
        acked_packets=2,
        lost_packets=0,
        one_way_s=one_way_s,
        received_us=int(now * 1e6),
        newest_bytes=size,
        rate_bps=8 * 2 * size / 0.002,
        is_limited=True,
        in_flight_bytes=20 * PACKET,
    )


def test_a_delay_that_ends_within_the_round_is_no_queue() -> None:
    control, rtt = settled()
    before = control.cwnd_bytes
    now = 0.8
    for step in range(12):  # a receiver that stood still reads all that waited: 170 ms late, then less and less
        now += 0.0001
        control.on_ack(sample(0.02 + 0.17 * (1 - step / 11), now=now), rtt=rtt, now=now)
    for _ in range(30):
        now += 0.002
        control.on_ack(sample(0.0206, now=now), rtt=rtt, now=now)
    assert control.cwnd_bytes > 0.9 * before


def test_more_delay_shrinks_the_window_step_by_step_until_it_proves_to_be_no_queue() -> None:
    control, rtt = settled()
    windows = [control._cwnd]
    for step in range(450):
        now = 0.8 + 0.002 * step
        control.on_ack(sample(0.08, now=now), rtt=rtt, now=now)
        windows.append(control._cwnd)
    changes = [(now, later / sooner) for now, (sooner, later) in enumerate(pairwise(windows)) if later < sooner]
    assert all(ratio >= 0.5 for _step, ratio in changes)
    assert min(b - a for (a, _), (b, _) in pairwise(changes)) >= 20  # 40 ms, a round trip
    assert 0.3 * windows[0] < windows[-1] < 0.8 * windows[0]
    assert control.queue_delay_s < 0.001  # draining changed nothing, so the path itself is longer


def test_small_packets_do_not_count_as_the_base_of_large_ones() -> None:
    control, rtt = settled()
    before = control.queue_delay_s
    for step in range(20):
        now = 0.8 + 0.002 * step
        small = step % 4 == 0
        control.on_ack(sample(0.012 if small else 0.0206, size=200 if small else PACKET, now=now), rtt=rtt, now=now)
    assert control.queue_delay_s == pytest.approx(before)


def test_a_slow_path_gets_small_datagrams_a_fast_one_full_ones() -> None:
    control, _rtt = settled()
    assert control.datagram_bytes == PACKET
    for rate_bps, low, high in ((600e3, 400, 600), (5e3, MIN_DATAGRAM_BYTES, MIN_DATAGRAM_BYTES)):
        control.rate_bps = rate_bps
        control._fit_datagram()
        assert low <= control.datagram_bytes <= high


def test_on_a_slow_link_no_two_packets_leave_at_once() -> None:
    pacer, now, times = Pacer(), 0.0, []
    for late_s in (0.0, 0.0, 0.01, 0.0, 0.003, 0.0):
        now = max(now, pacer.next_at_s) + late_s
        times.append(now)
        pacer.on_sent(1250, rate_bps=10e6, now=now)  # 1 ms each
    gaps = [later - sooner for sooner, later in pairwise(times)]
    assert min(gaps) >= 0.00075 - 1e-9


def test_on_a_fast_link_a_late_turn_is_caught_up() -> None:
    pacer = Pacer()
    pacer.on_sent(1250, rate_bps=1e9, now=1.0)
    assert pacer.packets_now(1250, rate_bps=1e9, limit=200, now=2.0) >= 100  # a millisecond's worth
