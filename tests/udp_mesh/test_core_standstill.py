"""A receiver that does not read for a while, on a busy machine: what it costs, with room in its socket and without."""

from __future__ import annotations

from typing import Any

import pytest

RATE_BPS = 4e6
DELAY_S = 0.05
BULK_BYTES = 20_000
PAYLOAD_SHARE = 1363 / 1442


def saturated(make_net: Any) -> Any:
    """Nodes a and b and a link that bulk keeps busy; ``lost`` are datagrams for which a socket had no room."""
    net = make_net(seed=5, delay_s=DELAY_S)
    net.add("a")
    net.add("b")
    net.meet()
    net.link("a", "b", rate_bps=RATE_BPS, limit_packets=400)
    net.published, net.lost = [], 0

    def bulk() -> None:
        while net.cores["a"].stats()["queued_bytes"] < 200_000:
            net.published.append(net.publish("a", "bulk", bytes(BULK_BYTES), "b", priority=9))

    net.every(0.02, bulk, until_s=net.now + 3.0)
    return net


def stand_still(net: Any, name: str, duration_s: float, *, socket_bytes: float = float("inf")) -> None:
    """Let a node read nothing from its socket for a while."""
    core = net.cores[name]
    waiting: list[tuple[Any, ...]] = []
    awake = core.receive_burst

    def doze(data: bytes, segment_bytes: int, path: Any, *, now: float) -> None:
        if sum(len(entry[0]) for entry in waiting) + len(data) > socket_bytes:
            net.lost += 1
        else:
            waiting.append((data, segment_bytes, path))

    def wake() -> None:
        core.receive_burst = awake
        for arrival in waiting:
            awake(*arrival, now=net.now)

    core.receive_burst = doze
    net.at(net.now + duration_s, wake)


def bulk_times(net: Any) -> list[float]:
    return [message.now for message in net.delivered("b", "bulk")]


def carried_bps(net: Any, begin_s: float, end_s: float) -> float:
    return 8 * BULK_BYTES * sum(begin_s <= t < end_s for t in bulk_times(net)) / (end_s - begin_s)


@pytest.mark.parametrize("duration_s", [0.17, 0.45, 0.7])
def test_bulk_is_back_as_soon_as_its_receiver_is(make_net: Any, duration_s: float) -> None:
    net = saturated(make_net)
    net.run(1.5)
    stand_still(net, "b", duration_s)
    since_s = net.now + duration_s
    net.run(duration_s + 1.0)
    assert min(t for t in bulk_times(net) if t > since_s - 0.001) < since_s + 0.05
    assert carried_bps(net, since_s + 0.1, since_s + 1.0) > 0.8 * RATE_BPS * PAYLOAD_SHARE


def test_a_socket_that_is_too_small_for_the_window_costs_little_and_loses_nothing(make_net: Any) -> None:
    net = saturated(make_net)
    net.run(1.5)
    window_bytes = net.cores["a"].window_bytes(0)
    stand_still(net, "b", 0.3, socket_bytes=window_bytes / 4)
    since_s = net.now + 0.3
    net.run(1.3)
    assert net.lost > 10
    assert carried_bps(net, since_s, since_s + 1.0) > 0.75 * RATE_BPS * PAYLOAD_SHARE
    net.run(4.0)
    assert sorted(m.message_id for m in net.delivered("b", "bulk")) == net.published
