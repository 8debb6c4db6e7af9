"""Which rate a link is said to have: what its data is sent at, however slowly HELLOs and acknowledgements go."""

from __future__ import annotations

from typing import Any

import pytest

OFDM_BPS = tuple(mbit * 1_000_000 for mbit in (6, 9, 12, 18, 24, 36, 48, 54))
#: Rates travel in one byte, an eighth of an octave a step.
ONE_BYTE = 2 ** (1 / 16) - 1 + 1e-6


def pair(make_mesh_net: Any, snr_db: float, **config: object) -> Any:
    net = make_mesh_net(**config)
    for name in "ab":
        net.add(name, rates_bps=OFDM_BPS)
    net.radio("a", "b", snr_db=snr_db)
    return net


def rate_bps(net: Any, name: str) -> float:
    [link] = net.stations[name].mesh.links(now=net.now)
    return float(link.rate_bps)


@pytest.mark.parametrize(("snr_db", "expected_bps"), [(33.0, 54e6), (20.0, 36e6), (9.5, 9e6)])
def test_a_link_has_the_rate_that_its_data_is_sent_at(make_mesh_net: Any, snr_db: float, expected_bps: float) -> None:
    net = pair(make_mesh_net, snr_db)
    net.run(5.0)
    assert rate_bps(net, "a") == pytest.approx(expected_bps, rel=ONE_BYTE), "before any data"
    net.every(0.1, lambda: net.send("a", "b"), until_s=net.now + 5.0)
    seen = set()
    net.every(0.05, lambda: seen.add(rate_bps(net, "a")), until_s=net.now + 10.0)
    net.run(10.0)
    assert sorted(seen) == [pytest.approx(expected_bps, rel=ONE_BYTE)], "with data, and after it"


def test_the_expected_time_goes_by_that_rate(make_mesh_net: Any) -> None:
    fast, slow = (pair(make_mesh_net, snr_db, metric="ett") for snr_db in (33.0, 9.5))
    costs = []
    for net in (fast, slow):
        net.run(5.0)
        costs.append(net.stations["a"].mesh.links(now=net.now)[0].cost_out)
    assert costs[1] / costs[0] == pytest.approx(6.0, rel=0.1), "54 and 9 Mbit/s"
