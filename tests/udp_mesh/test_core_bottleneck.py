"""A saturated link: bulk uses it, telemetry does not notice. And both the other way round when told so."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from udp_mesh.core.mesh import Refused

HEADERS_BYTES = 42 + 37


@dataclass(frozen=True, slots=True)
class Outcome:
    """``utilisation``: bulk payload over what the link could carry. ``excess_s``: latency above the base, sorted."""

    utilisation: float
    excess_s: list[float]

    def quantile(self, share: float) -> float:
        return self.excess_s[min(int(share * len(self.excess_s)), len(self.excess_s) - 1)]


def saturate(
    make_net: Any,
    *,
    rate_bps: float = 10e6,
    delay_s: float = 0.02,
    loss_ratio: float = 0.0,
    duration_s: float = 10.0,
    **settings: object,
) -> Outcome:
    net = make_net(seed=3, delay_s=delay_s)
    net.add("a", **settings)
    net.add("b", **settings)
    net.meet()
    net.link("a", "b", rate_bps=rate_bps, limit_packets=50, loss_ratio=loss_ratio)
    core, began_s, published = net.cores["a"], net.now, {}

    def bulk() -> None:
        while core.stats()["queued_bytes"] < 1_000_000:
            net.publish("a", "bulk", bytes(200_000), "b", priority=9)

    def telemetry() -> None:
        try:
            published[net.publish("a", "telemetry", bytes(200), "b", priority=1)] = net.now
        except Refused:
            return

    net.every(0.05, bulk, until_s=began_s + duration_s)
    net.every(0.0937, telemetry, until_s=began_s + duration_s)
    net.run(duration_s)
    base_s = delay_s + 8 * (200 + HEADERS_BYTES) / rate_bps
    excess = sorted(m.now - published[m.message_id] - base_s for m in net.delivered("b", "telemetry"))
    bulk_bps = 8 * sum(len(m.payload) for m in net.delivered("b", "bulk")) / duration_s
    return Outcome(bulk_bps / (rate_bps * (1 - loss_ratio) * 1363 / 1442), excess)


def test_bulk_fills_the_link_and_telemetry_stays_near_the_base(make_net: Any) -> None:
    outcome = saturate(make_net)
    assert outcome.utilisation >= 0.93
    assert outcome.quantile(0.5) <= 0.003
    assert outcome.quantile(0.99) <= 0.006


def test_loss_does_not_slow_bulk_down(make_net: Any) -> None:
    assert saturate(make_net, loss_ratio=0.05).utilisation >= 0.85


def test_heavy_loss_on_a_slow_link(make_net: Any) -> None:
    assert saturate(make_net, rate_bps=5e6, delay_s=0.03, loss_ratio=0.15).utilisation >= 0.8


def test_without_prioritisation_telemetry_waits_behind_bulk(make_net: Any) -> None:
    assert saturate(make_net, prioritise=False).quantile(0.5) > 0.2


def test_the_window_of_the_paper_wastes_a_long_link(make_net: Any) -> None:
    outcome = saturate(make_net, window=3)
    assert 0.03 < outcome.utilisation < 0.15  # 3 packets in each round trip of 42 ms
    assert outcome.quantile(0.99) < 0.045


@pytest.mark.parametrize(("rate_bps", "delay_s"), [(1e6, 0.01), (100e6, 0.002)])
def test_other_links_are_filled_as_well(make_net: Any, rate_bps: float, delay_s: float) -> None:
    outcome = saturate(make_net, rate_bps=rate_bps, delay_s=delay_s, duration_s=1.0 if rate_bps > 5e7 else 30.0)
    assert outcome.utilisation >= 0.8


def test_probes_take_a_small_part_of_a_slow_link(make_net: Any) -> None:
    net = make_net(seed=5, delay_s=0.01)
    net.add("a")
    net.add("b")
    net.meet()
    net.link("a", "b", rate_bps=100e3, limit_packets=50)
    for _ in range(12):
        net.publish("a", "bulk", bytes(10_000), "b")
    net.run(5.0)
    net.link("a", "b", is_cut=True)
    net.run(3.0)
    assert not net.cores["a"].peers(now=net.now)[0].online
    net.keep_datagrams = True
    net.run(20.0)
    sent_bits = sum(8 * (len(datagram.data) + 42) for _at, datagram in net.sent["a"])
    beacons_bits = 22 * 8 * 90
    assert 0 < sent_bits - beacons_bits < 0.02 * 100e3 * 20


def test_fragments_shrink_until_they_are_short_in_the_air(make_net: Any) -> None:
    net = make_net(seed=5, delay_s=0.01)
    net.add("a")
    net.add("b")
    net.meet()
    net.link("a", "b", rate_bps=600e3, limit_packets=100)
    for _ in range(4):
        net.publish("a", "bulk", bytes(20_000), "b", priority=9)
    net.run(2.0)
    net.keep_datagrams = True
    net.publish("a", "bulk", bytes(40_000), "b", priority=9)
    net.run(1.0)
    largest = max(len(datagram.data) for _at, datagram in net.sent["a"])
    assert 0.003 < 8 * (largest + 42) / 600e3 <= 0.0085
    assert len(net.delivered("b")) == 5


def test_broadcasts_are_paced_and_yield_to_what_is_more_urgent(make_net: Any) -> None:
    net = make_net(seed=5, delay_s=0.01)
    net.add("a")
    net.add("b")
    net.meet()
    net.keep_datagrams = True
    began_s = net.now
    for _ in range(30):
        net.publish("a", "map", bytes(1000), "all", priority=5)
    net.run(0.005)
    net.publish("a", "alarm", b"x", "all", priority=0)
    net.run(0.2)
    topics = [m.topic for m in net.delivered("b")]
    assert topics.count("map") == 30
    assert topics.index("alarm") < 10
    times = [at for at, packet in net.packets("a") if packet.is_broadcast and packet.fragments]
    assert times[-1] - began_s >= 29 * 8 * 1000 / 6e6  # nothing is known of this carrier


def test_broadcasts_count_towards_the_pace_of_the_link(make_net: Any) -> None:
    """A flood of broadcasts and bulk share the link instead of filling its queue."""
    net = make_net(seed=5, delay_s=0.01)
    net.add("a")
    net.add("b")
    net.meet()
    net.link("a", "b", rate_bps=10e6, limit_packets=50)

    def bulk() -> None:
        while net.cores["a"].stats()["queued_bytes"] < 200_000:
            net.publish("a", "bulk", bytes(50_000), "b", priority=9)

    net.every(0.02, bulk, until_s=net.now + 4)
    net.run(1.0)
    net.every(0.01, lambda: net.publish("a", "map", bytes(1200), "all", priority=5), until_s=net.now + 3)
    net.run(3.0)
    assert net.links["a", "b"].dropped == 0
    assert len(net.delivered("b", "map")) >= 295
