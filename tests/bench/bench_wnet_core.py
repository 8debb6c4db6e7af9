"""The mesh core's cost of one frame: to originate, to relay and to deliver it, in microseconds of this machine.

Three nodes in a row hand each other full frames in memory; each call is timed. Acknowledgements are part of it, as in
operation: one for every few frames. CPU time, so that others on the machine disturb little. ``ROUNDS`` and ``FRAMES``
may be set in the environment.
"""

from __future__ import annotations

import os
import random
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from wnet.config import MeshConfig
from wnet.core.mesh import Member, Mesh

ROUNDS = int(os.environ.get("ROUNDS", "7"))
FRAMES = int(os.environ.get("FRAMES", "3000"))
BATCH = 8
NAMES = ("origin", "relay", "end")


def mac(node: int, member: int = 0) -> bytes:
    """A node's address (member 0), or one of its members'."""
    return bytes((2, 0, 0, 0, member, node))


class Row:
    """Three meshes joined by wires, and the time that each has spent."""

    def __init__(self, key: bytes | None) -> None:
        config = MeshConfig(key=(key,) if key else ())
        self.now = 0.0
        self.spent_s = [0.0, 0.0, 0.0]
        counts = (1, 2, 1)
        self.meshes = [
            Mesh(
                config,
                mac(i + 1),
                [Member(mac(i + 1, m + 1), False, 1700) for m in range(count)],
                epoch=i + 1,
                rng=random.Random(i),
                now=0.0,
            )
            for i, count in enumerate(counts)
        ]
        self.joins = {(0, 0): (1, 0), (1, 0): (0, 0), (1, 1): (2, 0), (2, 0): (1, 1)}

    def turn(self, seconds: float, *, inners: list[bytes]) -> None:
        """Let time pass, then let every node in turn do what it has to, as its owner would."""
        self.now += seconds
        for inner in inners:
            start = time.thread_time()
            self.meshes[0].originate(inner, now=self.now)
            self.spent_s[0] += time.thread_time() - start
        for i in (0, 1, 2, 1, 0):
            start = time.thread_time()
            mesh = self.meshes[i]
            if (mesh.next_timer() or 0.0) <= self.now:
                mesh.handle_timer(now=self.now)
            sendings = mesh.frames_to_send(now=self.now)
            mesh.take_delivered()
            self.spent_s[i] += time.thread_time() - start
            for sending in sendings:
                receiver, member = self.joins[i, sending.member]
                start = time.thread_time()
                self.meshes[receiver].receive(member, sending.frame, now=self.now)
                self.spent_s[receiver] += time.thread_time() - start


def measure(payload_bytes: int, key: bytes | None) -> list[float]:
    """Return microseconds per frame of each node."""
    row = Row(key)
    for _ in range(400):
        row.turn(0.005, inners=[])
    inner = mac(3) + mac(1) + b"\x08\x00\x45\x00" + bytes(payload_bytes - 2)
    row.spent_s = [0.0, 0.0, 0.0]
    before = row.meshes[2].counts["delivered"]
    for _ in range(FRAMES // BATCH):
        row.turn(0.0007, inners=[inner] * BATCH)
    arrived = row.meshes[2].counts["delivered"] - before
    if arrived < 0.99 * FRAMES:
        raise SystemExit(f"only {arrived} of {FRAMES} frames arrived: the figures mean nothing")
    return [1e6 * spent / FRAMES for spent in row.spent_s]


def main() -> None:
    """Print one line per case."""
    print(f"{'case':24} " + " ".join(f"{name:>10}" for name in NAMES) + "   us per frame, median")
    for title, payload_bytes, key in (
        ("1400 bytes", 1400, None),
        ("1400 bytes, sealed", 1400, bytes(32)),
        ("100 bytes (aggregated)", 100, None),
    ):
        rounds = [measure(payload_bytes, key) for _ in range(ROUNDS)]
        medians = [statistics.median(values) for values in zip(*rounds, strict=True)]
        print(f"{title:24} " + " ".join(f"{value:10.1f}" for value in medians))


if __name__ == "__main__":
    main()
