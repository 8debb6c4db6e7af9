"""How long a team takes to be ready: nodes with a udp_mesh daemon each, from the command to the last ready report.

`python tests/bench/bench_lab.py [--rounds N] [NODES ...]`. Times are medians over the rounds; the bring-up of the
interfaces is part of the time to ready and shown beside it. Memory and CPU are those of the daemons alone.
"""

from __future__ import annotations

import argparse
import statistics
import time

from netlab.lab.facade import Lab

GOAL_NODES, GOAL_S = 20, 3.0


def scenario(nodes: int) -> dict[str, object]:
    """A line, so that each daemon has at most two neighbours."""
    return {
        "name": "bench",
        "duration": "10s",
        "generate": {
            "shape": "line",
            "count": nodes,
            "name": "n",
            "node": {"processes": ["udp_mesh"]},
            "link": {"delay": "2ms"},
        },
    }


def measure(nodes: int) -> tuple[float, float, float]:
    """Seconds to ready, seconds of interface bring-up, mean resident MB of a daemon."""
    started = time.perf_counter()
    with Lab(scenario(nodes), packets=False) as lab:
        ready_s = time.perf_counter() - started
        status = lab.status()
        assert all(process["state"] == "ready" for process in status["processes"])
        script = "cat $(printf '/proc/%s/smaps_rollup ' $@) | awk '/^Pss:/ {s += $2} END {print s}'"
        pids = [str(process["pid"]) for process in status["processes"]]
        pss_kb = float(lab.exec("n1", "sh", "-c", script, "sh", *pids).stdout or "nan")
        return ready_s, status["bring_up_s"], pss_kb / 1024 / nodes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("nodes", type=int, nargs="*", default=[2, 20, 50])
    options = parser.parse_args()
    print(f"{'nodes':>6} {'ready s':>9} {'min':>7} {'max':>7} {'bring-up s':>11} {'MB per daemon (PSS)':>20}")
    for nodes in options.nodes:
        rounds = [measure(nodes) for _ in range(options.rounds)]
        ready, bring_up, memory = (statistics.median(column) for column in zip(*rounds, strict=True))
        fastest, slowest = min(row[0] for row in rounds), max(row[0] for row in rounds)
        goal = f"   goal <= {GOAL_S:g} s" if nodes == GOAL_NODES else ""
        print(f"{nodes:>6} {ready:>9.2f} {fastest:>7.2f} {slowest:>7.2f} {bring_up:>11.3f} {memory:>20.1f}{goal}")


if __name__ == "__main__":
    main()
