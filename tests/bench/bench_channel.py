"""The shared channel: transmissions per second of processor time, throughput beside Bianchi's, cost of a matrix.

Run: python tests/bench/bench_channel.py. No namespaces; processor time, which a busy machine makes longer by a part
instead of a multiple. Goals: 15,000 transmissions a second with ten receivers each; throughput within 10 % of Bianchi's
(IEEE JSAC 18(3), 2000); a matrix of 50 radios 20 times a second in 2 % of a core.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "medium"))

from channels import channel, saturate, strengths, verdicts
from test_channel_theory import bianchi_frames_per_s

ROUNDS = int(os.environ.get("BENCH_ROUNDS", "3"))
SATURATED_S = 10.0
SMALL_BYTES, LARGE_BYTES = 200, 1500
GOAL_PER_S = 15_000


def spent_s(work: Callable[[], None]) -> float:
    """Processor time of ``work``, median of the rounds."""
    times = []
    for _ in range(ROUNDS):
        begin_s = time.process_time()
        work()
        times.append(time.process_time() - begin_s)
    return statistics.median(times)


def transmissions_per_s(senders: int, *, group: bool) -> float:
    """Ten receivers each: group frames of ``senders`` that keep the channel full, or unicast ones to one of them."""
    attempts = 0

    def work() -> None:
        nonlocal attempts
        used = channel(strengths(11))
        receiver = None if group else 10
        saturate(used, dict.fromkeys(range(senders), receiver), for_s=SATURATED_S, size_bytes=SMALL_BYTES)
        attempts = used.stats.attempts

    took_s = spent_s(work)
    return attempts / took_s


def matrix_s(radios: int) -> float:
    """Taking a matrix of new strengths."""
    used = channel(strengths(radios))
    matrices = [np.random.default_rng(seed).uniform(-100, -40, (radios, radios)) for seed in range(20)]

    def work() -> None:
        for matrix in matrices:
            used.set_rssi(matrix.tolist())

    return spent_s(work) / len(matrices)


def main() -> int:
    """Print the table; 1 where a goal is missed."""
    met = True
    print(f"{'channel, ten receivers each':34} {'transmissions/s':>16}  goal {GOAL_PER_S}")
    for label, senders, group in (
        ("group frames, 1 sender", 1, True),
        ("group frames, 10 senders, collisions", 10, True),
        ("unicast, 1 sender", 1, False),
        ("unicast, 10 senders, collisions", 10, False),
    ):
        rate = transmissions_per_s(senders, group=group)
        met &= rate >= GOAL_PER_S
        print(f"{label:34} {rate:16,.0f}")
    print(f"\n{'saturated stations':>18} {'frames/s':>9} {'Bianchi':>9} {'ratio':>7}")
    for stations in (2, 5, 10, 20):
        flows: dict[int, int | None] = dict.fromkeys(range(stations), stations)
        decided = saturate(channel(strengths(stations + 1)), flows, for_s=SATURATED_S, size_bytes=LARGE_BYTES)
        measured, theory = verdicts(decided)["DELIVERED"] / SATURATED_S, bianchi_frames_per_s(stations, LARGE_BYTES)
        met &= abs(measured / theory - 1) < 0.1
        print(f"{stations:18} {measured:9.1f} {theory:9.1f} {measured / theory:7.3f}")
    took_s = matrix_s(50)
    print(f"\na matrix of 50 radios: {took_s * 1e3:.2f} ms, at 20 Hz {100 * 20 * took_s:.1f} % of a core")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
