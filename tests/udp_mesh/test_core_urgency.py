"""The more urgent goes first, to whomever: random mixes of sizes, priorities, rates and losses, drawn by Hypothesis."""

from __future__ import annotations

import contextlib
from collections import defaultdict
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from udp_mesh.core import events
from udp_mesh.core.mesh import Refused
from udp_mesh.core.settings import Keep, Reliability

RELAXED = settings(
    deadline=None,
    phases=[Phase.explicit, Phase.generate],  # a story is long: shrinking one takes minutes
    suppress_health_check=[HealthCheck.too_slow],
)
FRAGMENT_BYTES = 1400 + 42
HANDED_TO_THE_KERNEL_S = 0.002
RECEIVERS = ("b", "c")

rates = st.sampled_from([3e5, 1e6, 5e6, 2e7, 1e8])
publishes = st.lists(
    st.fixed_dictionaries(
        {
            "gap_s": st.sampled_from([0.0, 0.0, 0.0003, 0.004, 0.03, 0.3]),
            "to": st.sampled_from([*RECEIVERS, *RECEIVERS, "all"]),
            "size": st.sampled_from([0, 10, 600, 1300, 4000, 30_000, 300_000]),
            "priority": st.integers(0, 9),
            "reliability": st.sampled_from([Reliability.RELIABLE, Reliability.BEST_EFFORT]),
            "keep": st.sampled_from([Keep.ALL, Keep.LATEST]),
            "lifetime_s": st.sampled_from([None, None, 0.05, 2.0]),
            "redundancy": st.sampled_from([1, 1, 1, 2, 3]),
        }
    ),
    min_size=5,
    max_size=40,
)


def saturated(make_net: Any, seed: int, rates_bps: tuple[float, float], **link: float) -> Any:
    """A node with bulk for two receivers, for a while already."""
    net = make_net(seed=seed, limit_packets=50, **link)
    net.add("a", trace_fragments=True)
    for name, rate_bps in zip(RECEIVERS, rates_bps, strict=True):
        net.add(name)
        net.link("a", name, rate_bps=rate_bps)
    net.meet(6.0)
    for name, rate_bps in zip(RECEIVERS, rates_bps, strict=True):
        for _ in range(2):
            net.publish("a", "bulk", bytes(min(4_000_000, int(rate_bps))), name, priority=9)
    net.run(1.5)
    return net


@given(
    seed=st.integers(0, 1 << 32),
    rates_bps=st.tuples(rates, rates),
    delay_s=st.floats(0.0005, 0.05),
    loss_ratio=st.sampled_from([0.0, 0.0, 0.02, 0.2]),
    steps=publishes,
)
@settings(RELAXED, max_examples=15)
def test_nothing_less_urgent_leaves_between_a_publish_and_its_fragments(
    make_net: Any, seed: int, rates_bps: tuple[float, float], delay_s: float, loss_ratio: float, steps: list[Any]
) -> None:
    net = saturated(make_net, seed, rates_bps, delay_s=delay_s, loss_ratio=loss_ratio)
    published: dict[int, tuple[int, int]] = {}  # message id -> (priority, number of the events before)
    for step in steps:
        policy = {key: value for key, value in step.items() if key not in ("gap_s", "to", "size")}
        net.run(step["gap_s"])
        before = len(net.events["a"])
        with contextlib.suppress(Refused):
            message_id = net.publish("a", f"t{step['priority']}", bytes(step["size"]), step["to"], **policy)
            published[message_id] = step["priority"], before
    net.run(1.0)
    check_order(net.events["a"], published)


def check_order(own: list[events.Event], published: dict[int, tuple[int, int]]) -> None:
    """Look at every first transmission: what has left for the same destination since its message was published?"""
    left: dict[str, list[tuple[int, int]]] = defaultdict(list)  # by destination: (number of the event, priority)
    seen: set[tuple[int, int, str]] = set()
    for number, event in enumerate(own):
        if not isinstance(event, events.FragmentSent | events.FragmentRetransmitted | events.FragmentCopied):
            continue
        key = (event.message_id, event.fragment_index, event.peer)
        if event.message_id in published and key not in seen:
            priority, since = published[event.message_id]
            assert priority == event.priority
            ahead = [at for at, level in reversed(left[event.peer]) if at >= since and level > priority]
            assert not ahead, f"{event} waited for {[own[at] for at in ahead]}"
        seen.add(key)
        left[event.peer].append((number, event.priority))


@given(
    seed=st.integers(0, 1 << 32),
    rate_bps=rates,
    delay_s=st.floats(0.001, 0.05),
    gaps_s=st.lists(st.floats(0.02, 0.06), min_size=30, max_size=30),
)
@settings(RELAXED, max_examples=6)
def test_behind_a_bottleneck_two_fragments_or_two_milliseconds_are_ahead_of_the_urgent(
    make_net: Any, seed: int, rate_bps: float, delay_s: float, gaps_s: list[float]
) -> None:
    """What was handed to the kernel waits at the bottleneck; while the flow probes for its share, up to twice that."""
    net = make_net(seed=seed, limit_packets=50, delay_s=delay_s, rate_bps=rate_bps)
    net.add("a")
    net.add("b")
    net.meet(6.0)
    for _ in range(2 + int(8 * rate_bps / 8 / 1_500_000)):
        net.publish("a", "bulk", bytes(1_500_000), "b", priority=9)
    net.run(5.0)
    limit_s = max(HANDED_TO_THE_KERNEL_S, 2 * 8 * FRAGMENT_BYTES / rate_bps)
    waits = []
    for gap_s in gaps_s:
        net.run(gap_s)
        waits.append(max(0.0, net.links["a", "b"].free_at_s - net.now) / limit_s)
        net.publish("a", "urgent", bytes(100), "b", priority=0)
    waits.sort()
    assert waits[len(waits) // 2] <= 1.0, waits
    assert waits[-1] <= 2.0, waits


@given(
    seed=st.integers(0, 1 << 32),
    rate_bps=st.sampled_from([5e3, 4e4, 1e6]),
    gaps_s=st.lists(st.floats(0.01, 3.0), min_size=5, max_size=5),
)
@settings(RELAXED, max_examples=6)
def test_a_carrier_of_known_rate_never_holds_more_than_two_fragments(
    make_net: Any, seed: int, rate_bps: float, gaps_s: list[float]
) -> None:
    net = make_net(seed=seed, delay_s=0.002, rate_bps=rate_bps)
    for name in ("a", "b"):
        core = net.add(name, payload_bytes=250)
        core.add_carrier(0, mtu_bytes=250, rate_bps=rate_bps * 250 / (250 + 42))  # the fake link counts headers
    net.meet(20.0)
    net.publish("a", "bulk", bytes(20_000), "b", priority=9)
    net.run(1.0)
    fragment_s = 8 * (250 + 42) / rate_bps
    for gap_s in gaps_s:
        net.run(gap_s)
        assert net.links["a", "b"].free_at_s - net.now <= 2 * fragment_s
        net.publish("a", "urgent", bytes(20), "b", priority=0)
