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
    outcome = saturate(make_net, rate_bps=rate_bps, delay_s=delay_s, duration_s=1.0 if rate_bps > 5e7 else 12.0)
    assert outcome.utilisation >= 0.8
