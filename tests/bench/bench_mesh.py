"""How long a mesh takes to find another way, and to carry again after an outage: five nodes, silent cuts.

`python tests/bench/bench_mesh.py [--runs N] [--engine E] [ALGORITHM ...]`. Runs topologies/relay_diamond.yaml's nodes
and traffic in virtual time (it opens a box by itself), once per figure: a minute to settle, then the hop is cut that
carries at that moment. Which one that is tell the counters of the interfaces, so that it is the same for every mesh.
The delay ends when each direction has delivered a message that was published since. Beside it stands what was measured
without this lab: the same five nodes as plain network namespaces in real time, ping at 20 Hz, medians.
"""

from __future__ import annotations

import argparse
import os
import random
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from netlab.errors import MachineError
from netlab.lab.facade import Lab
from netlab.traces.reroutes import fresh_delay_s
from netlab.vm.fitness import INSIDE
from netlab.vm.kernels import select
from netlab.vm.request import Clock, KernelChoice

SCENARIO = Path(__file__).parents[2] / "topologies" / "relay_diamond.yaml"
ENDS = ("a", "b")
HOPS = (("a", "relay1"), ("relay1", "b"), ("a", "relay2"), ("relay2", "b"), ("a", "relay3"), ("relay3", "relay2"))
# batman-adv IV judges a link by its last 64 routing messages: sooner, it still makes up its mind and changes it easily.
SETTLE_S, BEGIN_S, DEAD_S = 66.0, 2.0, 15.0
ALGORITHMS = ("BATMAN_IV", "BATMAN_V")


@dataclass(frozen=True)
class Case:
    """What is cut, how long the run lasts, and the other measurement's medians in seconds, per algorithm."""

    name: str
    duration: str
    act: Callable[[Lab, float], None]
    elsewhere: tuple[str, str]


def carrier(lab: Lab, node: str, counter: str, at_s: float) -> str:
    """The neighbour over whose wire most bytes went in the second before ``at_s``."""
    others = [b if a == node else a for a, b in HOPS if node in (a, b)]  # eth0, eth1, ... in this order
    paths = [f"/sys/class/net/eth{number}/statistics/{counter}" for number in range(len(others))]

    def read() -> list[int]:
        return [int(word) for word in lab.exec(node, "cat", *paths).stdout.split()]

    lab.wait_until(at_s - 1.0)
    before = read()
    lab.wait_until(at_s)
    grown = [after - earlier for earlier, after in zip(before, read(), strict=True)]
    return others[grown.index(max(grown))]


def cut_last_hop(lab: Lab, at_s: float) -> None:
    lab.outage(carrier(lab, "b", "rx_bytes", at_s), "b", active=True)


def cut_first_hop(lab: Lab, at_s: float) -> None:
    lab.outage("a", carrier(lab, "a", "tx_bytes", at_s), active=True)


def all_dead(lab: Lab, at_s: float, *, old_relay_returns: bool) -> None:
    old = carrier(lab, "b", "rx_bytes", at_s)
    for a, b in HOPS:
        lab.outage(a, b, active=True)
    lab.wait_until(at_s + DEAD_S)
    for a, b in HOPS:
        if old_relay_returns or old not in (a, b):
            lab.outage(a, b, active=False)


CASES = (
    Case("relay-b cut", "18s", cut_last_hop, ("5.1", "5.0")),
    Case("a-relay cut", "18s", cut_first_hop, ("5.1", "4.9")),
    Case("all dead 15 s, all return", "25s", lambda lab, t: all_dead(lab, t, old_relay_returns=True), ("~0", "~0")),
    Case(
        "all dead 15 s, old relay not", "33s", lambda lab, t: all_dead(lab, t, old_relay_returns=False), ("5.0", "0.85")
    ),
)


def measure(case: Case, algorithm: str, engine: str, seed: int) -> float | None:
    """Seconds from the last cut or restoration until both directions carry again; None: not before the run's end."""
    at_s = BEGIN_S + random.Random(seed).random()  # anywhere between two routing messages
    words = ["mesh=batman-adv", "events=[]", "expect=[]", f"duration={case.duration}"]
    words.append(f"batman_adv.routing_algorithm={algorithm}")
    with Lab(SCENARIO, engine=engine, seed=seed, overrides=words, packets=False) as lab:
        time.sleep(SETTLE_S)  # of virtual time, and nobody sends: cheap
        lab.begin()
        case.act(lab, at_s)
        result = lab.finish()
    assert not result.failures, result.report()
    acts = [step.t_ns for step in result.trace.timeline if step.kind == "outage"]
    return fresh_delay_s(result.trace, ENDS, acts[-1])


def report(options: argparse.Namespace) -> None:
    """Print one line per algorithm and case."""
    print(f"{'mesh':<11} {'case':<29} {'median s':>9} {'min':>7} {'max':>7} {'runs':>5} {'elsewhere':>10}", flush=True)
    for algorithm in options.algorithm:
        for case in CASES:
            found = [measure(case, algorithm, options.engine, seed) for seed in range(1, options.runs + 1)]
            delays = [delay for delay in found if delay is not None]
            never = f"  never in {len(found) - len(delays)}" if len(delays) < len(found) else ""
            figures = (statistics.median(delays), min(delays), max(delays)) if delays else (float("nan"),) * 3
            told = " ".join(f"{value:>{width}.3f}" for value, width in zip(figures, (9, 7, 7), strict=True))
            elsewhere = case.elsewhere[ALGORITHMS.index(algorithm)]
            print(f"{algorithm:<11} {case.name:<29} {told} {len(delays):>5} {elsewhere:>10}{never}", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--engine", default="air")
    parser.add_argument("algorithm", nargs="*", default=list(ALGORITHMS), help="BATMAN_IV, BATMAN_V")
    options = parser.parse_args()
    if INSIDE in os.environ:
        report(options)
        return 0
    try:
        select(KernelChoice.UML, Clock.VIRTUAL)
    except MachineError as error:
        print(f"not measured: {error}")
        return 0
    box = [sys.executable, "-m", "netlab", "vm", "--clock", "virtual", "--timeout", "3000", "--"]
    return subprocess.run(
        [*box, sys.executable, __file__, *sys.argv[1:]], cwd=SCENARIO.parents[1], check=False
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
