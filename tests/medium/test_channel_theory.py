"""The shared channel against closed forms: saturation throughput, queueing delay, fairness, fixed times."""

from __future__ import annotations

import random
import statistics
from itertools import pairwise

import pytest
from channels import SIX, G, channel, drain, on_air_s, saturate, strengths, verdicts

SATURATED_S = 6.0
SIZE_BYTES = 1500


def bianchi_frames_per_s(stations: int, size_bytes: int) -> float:
    """Saturation throughput of the basic access method, in frames.

    Source: G. Bianchi, "Performance Analysis of the IEEE 802.11 Distributed Coordination Function", IEEE JSAC 18(3),
    2000: eq. 7 (tau), 9 (p), 13 (S), 14 (T_s), with W = CWmin + 1 and W 2^m = CWmax + 1. A collision keeps the channel
    as long as a success here, for those who hear one wait EIFS.
    """
    window = G.cw_min + 1
    stages = ((G.cw_max + 1) // window).bit_length() - 1
    low, high = 0.0, 0.5 - 1e-9
    if collides(tau(high, window, stages), stations) > high:
        low, high = 0.5 + 1e-9, 1.0
    for _ in range(60):
        p = (low + high) / 2
        low, high = (p, high) if collides(tau(p, window, stages), stations) > p else (low, p)
    sends = tau(p, window, stages)
    busy = 1 - (1 - sends) ** stations
    success = stations * sends * (1 - sends) ** (stations - 1) / busy
    exchange_s = on_air_s(size_bytes) + G.sifs_s + G.ack_s(SIX) + G.difs_s
    return success * busy / ((1 - busy) * G.slot_s + busy * exchange_s)


def tau(p: float, window: int, stages: int) -> float:
    return 2 * (1 - 2 * p) / ((1 - 2 * p) * (window + 1) + p * window * (1 - (2 * p) ** stages))


def collides(sends: float, stations: int) -> float:
    return float(1 - (1 - sends) ** (stations - 1))


@pytest.mark.parametrize("stations", [2, 5, 10, 20])
def test_saturation_throughput_is_bianchis(stations: int) -> None:
    used = channel(strengths(stations + 1))
    decided = saturate(used, dict.fromkeys(range(stations), stations), for_s=SATURATED_S, size_bytes=SIZE_BYTES)
    measured = verdicts(decided)["DELIVERED"] / SATURATED_S
    assert measured == pytest.approx(bianchi_frames_per_s(stations, SIZE_BYTES), rel=0.03)


def test_saturated_stations_share_fairly() -> None:
    decided = saturate(channel(strengths(3)), {0: 2, 1: 2}, for_s=SATURATED_S)
    frames = [sum(done.sender == sender for done in decided) for sender in (0, 1)]
    assert frames[0] == pytest.approx(frames[1], rel=0.05)


@pytest.mark.parametrize("load", [0.3, 0.7])
def test_poisson_arrivals_wait_as_in_a_queue_with_constant_service(load: float) -> None:
    """M/D/1: mean wait = rho / (2 (1 - rho)) x service (Pollaczek-Khinchine; back-off varies service by 2 % only)."""
    service_s = on_air_s(SIZE_BYTES) + G.difs_s + G.cw_min / 2 * G.slot_s
    rng, now, used = random.Random(5), 0.0, channel(strengths(2))
    waits_s = []
    for _ in range(8000):
        now += rng.expovariate(load / service_s)
        for done in used.advance(now):
            waits_s.append(done.at_s - done.offered_s - service_s)
        used.offer(0, bytes(SIZE_BYTES), None, now=now)
    expected_s = load / (2 * (1 - load)) * service_s
    # Who finds the channel idle for long has no DIFS to wait.
    assert statistics.fmean(waits_s) == pytest.approx(expected_s - (1 - load) * G.difs_s, rel=0.1)


def test_a_frame_on_an_idle_channel_takes_its_back_off_and_its_airtime() -> None:
    used, now, slots = channel(strengths(2)), 5.0, set()
    for _ in range(200):
        used.advance(now)
        used.offer(0, bytes(1000), 1, now=now)
        done = drain(used)[0]
        slots.add(round((done.at_s - now - on_air_s(1000)) / G.slot_s, 3))
        now += 1.0
    assert slots == {float(slot) for slot in range(G.cw_min + 1)}


def test_the_next_frame_waits_for_acknowledgement_difs_and_back_off() -> None:
    used = channel(strengths(2))
    for _ in range(100):
        used.offer(0, bytes(1000), 1, now=0.0)
    ends = [done.at_s for done in drain(used)]
    gaps = [b - a - on_air_s(1000) - G.sifs_s - G.ack_s(SIX) - G.difs_s for a, b in pairwise(ends)]
    slots = {round(gap / G.slot_s, 3) for gap in gaps}
    assert slots <= {float(slot) for slot in range(G.cw_min + 1)}
    assert len(slots) > 10


def test_the_channel_is_busy_for_what_it_says() -> None:
    used = channel(strengths(3))
    decided = saturate(used, {0: 2, 1: 2}, for_s=2.0)
    stats = used.stats
    assert stats.attempts == pytest.approx(stats.acknowledged / (1 - 0.11), rel=0.05)
    expected_s = stats.attempts * on_air_s(1500) + len(decided) * G.ack_s(SIX)
    assert stats.airtime_s == pytest.approx(expected_s, rel=0.01)
