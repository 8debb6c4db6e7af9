"""Stored messages while both daemons are killed and restarted at random instants of outages: how many lost, or twice.

Run: python tests/bench/bench_udp_mesh_store.py [trials] [seed]. Each trial: an outage of 1.5 s; each daemon killed with
SIGKILL at a random instant between 0.5 s before it and 0.5 s after it, and started again within 0.8 s; traffic of three
stored topics all the while. Up to 25 trials follow each other in one lab. In virtual time where the
box's kernel is built (`netlab vm build`), else in real time.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

TRIAL_S = 4.0
TRIALS_PER_LAB = 25
GOAL = "0 lost, 0 delivered twice"


def scenario(trials: int, seed: int) -> str:
    """Return the scenario of so many trials as text."""
    rng = Random(seed)
    events = []
    for trial in range(trials):
        outage_s = 1.0 + trial * TRIAL_S
        events.append(f"  - {{at: {outage_s:.3f}s, outage: {{between: [a, b], for: 1.5s}}}}")
        for node in "ab":
            at_s, restart_s = outage_s + rng.uniform(-0.5, 2.0), rng.uniform(0.05, 0.8)
            kill = f"{{node: {node}, process: udp_mesh}}"
            events.append(f"  - {{at: {at_s:.3f}s, kill: {kill}, restart: {restart_s * 1000:.0f}ms}}")
    return "\n".join(
        [
            f"name: store-trials\nseed: {seed}\nduration: {2 + trials * TRIAL_S:.0f}s\nengine: air",
            "nodes:\n  a: {processes: [udp_mesh]}\n  b: {processes: [udp_mesh]}",
            "links:\n  - {between: [a, b], rate: 10mbit, delay: 10ms, loss: 1%}",
            "traffic:",
            "  - {from: a, to: b, topic: log, priority: 3, size: 300B, rate: 20Hz, offline: store}",
            "  - {from: a, to: b, topic: photo, priority: 6, size: 40kB, rate: 1Hz, offline: store}",
            "  - {from: b, to: a, topic: order, priority: 1, size: 100B, rate: 5Hz, offline: store}",
            "events:",
            *events,
            "expect:",
            *(f"  - {{delivered: {{topic: {topic}}}, min: 100%}}" for topic in ("log", "photo", "order")),
            "",
        ]
    )


def run(file: Path, *, virtual: bool) -> dict[str, object]:
    """Run the scenario; return what `--json` prints."""
    where = ["--in", "vm", "--clock", "virtual"] if virtual else []
    command = [sys.executable, "-m", "netlab", "run", str(file), *where, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    start = done.stdout.find("{")
    if done.returncode not in (0, 1) or start < 0:
        raise SystemExit(f"the lab did not run: {done.stderr[-2000:]}")
    result: dict[str, object] = json.loads(done.stdout[start:])
    return result


def has_box() -> bool:
    """Whether virtual time is to be had."""
    probe = [sys.executable, "-m", "netlab", "vm", "--clock", "virtual", "--", "true"]
    return subprocess.run(probe, capture_output=True, check=False).returncode == 0


def count(trials: int, seed: int, *, virtual: bool, totals: dict[str, list[int]]) -> None:
    """Run trials in one lab; add what was sent, lost and delivered twice to ``totals``, by topic."""
    with TemporaryDirectory(dir=Path.cwd()) as folder:  # not below /tmp, which the box hides
        file = Path(folder) / "store-trials.yaml"
        file.write_text(scenario(trials, seed))
        streams = run(file, virtual=virtual)["streams"]
    assert isinstance(streams, list)
    for stream in streams:
        figures = totals.setdefault(stream["topic"], [0, 0, 0])
        for index, value in enumerate((stream["sent"], stream["sent"] - stream["delivered"], stream["duplicates"])):
            figures[index] += value


def main(trials: int = 200, seed: int = 1) -> int:
    """Print a line per topic; 0 if the goal is met."""
    virtual = has_box()
    totals: dict[str, list[int]] = {}
    print(f"store: {trials} trials, seed {seed}, {'virtual' if virtual else 'real'} time; goal: {GOAL}")
    for begun in range(0, trials, TRIALS_PER_LAB):
        count(min(TRIALS_PER_LAB, trials - begun), seed + begun, virtual=virtual, totals=totals)
        print(f"  {min(begun + TRIALS_PER_LAB, trials)} trials done", file=sys.stderr, flush=True)
    for topic, (sent, lost, twice) in totals.items():
        print(f"  {topic:<6} {sent:>6} sent, {lost} lost, {twice} delivered twice")
    is_met = all(figures[1:] == [0, 0] for figures in totals.values())
    print("met" if is_met else "NOT met")
    return 0 if is_met else 1


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
