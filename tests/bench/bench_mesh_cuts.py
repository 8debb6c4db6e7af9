"""How long a mesh takes to find another way, and to carry again after an outage: silent cuts, probes at 50 Hz.

`python tests/bench/bench_mesh_cuts.py [--cycles N] [--engine E] [MESH ...]`, with the meshes of ``mesh_rig_lab.py``; in
virtual time (it opens a box by itself). A relay is cut, or a hop, while it carries: which one does tell the counters of
the interfaces, so that it is the same for every mesh. The delay ends when both ends have got a datagram that was sent
since. Every figure is over all cycles of one lab; between them everything is whole until the mesh has settled.

Topologies: the nodes of relay_diamond.yaml (a-relay1-b, a-relay2-b, a-relay3-relay2), and a line of three hops.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mesh_rig_lab import MESHES, Mesh, Probes, fresh_delay_s, quantile

from netlab.errors import MachineError
from netlab.lab.facade import Lab
from netlab.vm.fitness import INSIDE
from netlab.vm.kernels import select
from netlab.vm.request import Clock, KernelChoice

DIAMOND = (("a", "relay1"), ("relay1", "b"), ("a", "relay2"), ("relay2", "b"), ("a", "relay3"), ("relay3", "relay2"))
LINE = (("a", "relay1"), ("relay1", "relay2"), ("relay2", "b"))
HOP_DELAY = "2ms"
RATE_HZ = 50.0
DEAD_S = 15.0
ENDS = ("a", "b")

Hop = tuple[str, str]


@dataclass(frozen=True)
class Case:
    """What is cut: ``choose`` gives the hops; ``restored`` those that come back after ``DEAD_S``, where it is that."""

    name: str
    hops: tuple[Hop, ...]
    choose: Callable[[Lab], list[Hop]]
    restored: Callable[[list[Hop], str], list[Hop]] | None = None


def carrier(lab: Lab, node: str, counter: str) -> str:
    """The neighbour over whose wire most bytes go in one second from now."""
    others = [b if a == node else a for a, b in DIAMOND if node in (a, b)]  # eth0, eth1, ... in this order
    paths = [f"/sys/class/net/eth{number}/statistics/{counter}" for number in range(len(others))]

    def read() -> list[int]:
        return [int(word) for word in lab.exec(node, "cat", *paths).stdout.split()]

    before = read()
    time.sleep(1.0)
    grown = [after - earlier for earlier, after in zip(before, read(), strict=True)]
    return others[grown.index(max(grown))]


def silent_relay(lab: Lab) -> list[Hop]:
    relay = carrier(lab, "b", "rx_bytes")
    return [hop for hop in DIAMOND if relay in hop]


CASES = (
    Case("relay silent", DIAMOND, silent_relay),
    Case("relay-b cut", DIAMOND, lambda lab: [(carrier(lab, "b", "rx_bytes"), "b")]),
    Case("a-relay cut", DIAMOND, lambda lab: [("a", carrier(lab, "a", "tx_bytes"))]),
    Case("3 hops dead 15 s", LINE, lambda _lab: list(LINE), lambda hops, _old: hops),
    Case("all dead 15 s", DIAMOND, lambda _lab: list(DIAMOND), lambda hops, _old: hops),
    Case(
        "all dead 15 s, old relay stays",
        DIAMOND,
        lambda _lab: list(DIAMOND),
        lambda hops, old: [hop for hop in hops if old not in hop],
    ),
)


def scenario(hops: tuple[Hop, ...]) -> dict[str, object]:
    """Nodes and wires, no traffic of the lab's own."""
    return {
        "name": "mesh",
        "duration": "1h",
        "nodes": {name: {} for name in dict.fromkeys(name for hop in hops for name in hop)},
        "links": [{"between": list(hop), "delay": HOP_DELAY} for hop in hops],
    }


def measure(case: Case, mesh: Mesh, engine: str, cycles: int) -> list[float | None]:
    """Seconds per cycle from the cut or the restoration until both ends get what was sent since; None: never."""
    rng = random.Random(case.name)
    acts: list[tuple[int, int]] = []
    cycle_s = 1.0 + 2.0 + (DEAD_S if case.restored else 0.0) + mesh.patience_s + mesh.settle_s
    with Lab(scenario(case.hops), engine=engine, overrides=list(mesh.overrides), packets=False) as lab:
        time.sleep(mesh.settle_s)
        probes = Probes(lab)
        lasts_s = cycles * cycle_s + 5.0
        for number, (node, other) in enumerate((ENDS, ENDS[::-1])):
            words = ("--to", address(lab, other), "--rate", str(RATE_HZ), "--number", str(number))
            probes.start(node, *words, lasts_s=lasts_s)
        for _ in range(cycles):
            acts.append(cycle(lab, case, mesh, rng.random()))
            time.sleep(mesh.settle_s)
        told = probes.results()
    return [fresh_delay_s(told, since_ns, until_ns) for since_ns, until_ns in acts]


def cycle(lab: Lab, case: Case, mesh: Mesh, wait_s: float) -> tuple[int, int]:
    """Cut, and make whole again; returns when the act was that is measured, and until when it counts."""
    time.sleep(wait_s)  # anywhere between two routing messages
    old = carrier(lab, "b", "rx_bytes") if case.hops is DIAMOND else ""
    hops = case.choose(lab)
    since_ns = switch(lab, hops, active=True)
    if case.restored is None:
        time.sleep(mesh.patience_s)
        until_ns = switch(lab, hops, active=False)
        return since_ns, until_ns
    time.sleep(DEAD_S)
    restored = case.restored(hops, old)
    since_ns = switch(lab, restored, active=False)
    time.sleep(mesh.patience_s)
    until_ns = switch(lab, [hop for hop in hops if hop not in restored], active=False)
    return since_ns, until_ns


def switch(lab: Lab, hops: list[Hop], *, active: bool) -> int:
    for a, b in hops:
        lab.outage(a, b, active=active)
    return time.time_ns()


def address(lab: Lab, node: str) -> str:
    return lab.exec(node, "getent", "hosts", node).stdout.split()[0]


def report(options: argparse.Namespace) -> None:
    """Print one line per mesh and case."""
    heads = f"{'p50 s':>8} {'p90 s':>8} {'max s':>8} {'cycles':>7} {'never':>6}"
    print(f"{'mesh':<18} {'case':<31} {heads}", flush=True)
    for name in options.mesh:
        mesh = MESHES[name]
        for case in CASES:
            if options.case and options.case not in case.name:
                continue
            found = measure(case, mesh, options.engine, options.cycles)
            delays = [float("inf") if delay is None else delay for delay in found]
            figures = " ".join(
                f"{value:>8.3f}" for value in (quantile(delays, 0.5), quantile(delays, 0.9), max(delays))
            )
            print(f"{name:<18} {case.name:<31} {figures} {len(found):>7} {found.count(None):>6}", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=10)
    parser.add_argument("--engine", default="air")
    parser.add_argument("--case", default="", help="only cases with this in their name")
    parser.add_argument("mesh", nargs="*", default=list(MESHES), help=", ".join(MESHES))
    options = parser.parse_args()
    if INSIDE in os.environ:
        report(options)
        return 0
    return in_box(__file__, sys.argv[1:])


def in_box(script: str, words: list[str]) -> int:
    """Run a benchmark again in a box with virtual time; returns its exit code."""
    try:
        select(KernelChoice.UML, Clock.VIRTUAL)
    except MachineError as error:
        print(f"not measured: {error}")
        return 0
    box = [sys.executable, "-m", "netlab", "vm", "--clock", "virtual", "--timeout", "3000", "--"]
    return subprocess.run([*box, sys.executable, script, *words], cwd=Path(__file__).parents[2], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
