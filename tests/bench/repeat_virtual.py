"""Runs the tests of virtual time again and again beside a CPU hog, and compares every stream's figures over the runs.

    .venv/bin/python tests/bench/repeat_virtual.py --runs 20

By hand, not in CI: a run takes minutes. As many processes as there are processors burn CPU beside it all the while. Any
losses of netem are drawn anew in each run (Linux 6.1 has no seed) and are listed without judgement; all other figures
must agree. Ends with 1 if a run failed or a figure differs by more than 0.1 ms.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[2]
TESTS = "tests/vm/test_virtual_time.py"
DRAWN_ANEW = "lossy/netem"
TOLERANCE_S = 0.0001


@contextlib.contextmanager
def hog(count: int) -> Iterator[None]:
    """``count`` processes that burn CPU; ended by their ids."""
    burning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in burning:
            process.kill()
            process.wait()


def run_once(boxes: int) -> tuple[bool, float, dict[str, list[dict[str, float]]]]:
    """Whether all passed, real seconds, and each stream's figures in the order of the tests."""
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="netlab-repeat-") as folder:
        junit = Path(folder, "junit.xml")
        argv = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", TESTS, f"-n{boxes}"]
        options = [f"--junitxml={junit}", "-o", "junit_family=xunit1"]
        done = subprocess.run([*argv, *options], cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode:
            print(done.stdout[-3000:], done.stderr[-1000:])
        return done.returncode == 0, time.monotonic() - began_s, figures(junit)


def figures(junit: Path) -> dict[str, list[dict[str, float]]]:
    """Stream -> its figures, one entry per time that it ran."""
    found: dict[str, list[dict[str, float]]] = defaultdict(list)
    for element in ElementTree.parse(junit).iter("property"):
        found[element.attrib["name"]].append(json.loads(element.attrib["value"]))
    return found


def compare(runs: list[dict[str, list[dict[str, float]]]]) -> bool:
    """Print median and spread of every figure; whether all that must agree does."""
    agree = True
    print(f"\n{'stream':<44} {'figure':<6} {'median ms':>12} {'spread ms':>10}")
    for stream in sorted({stream for run in runs for stream in run}):
        for number in range(max(len(run[stream]) for run in runs)):
            for key in ("p50", "p99"):
                values = sorted(run[stream][number][key] for run in runs if len(run[stream]) > number)
                spread_s = values[-1] - values[0]
                wrong = spread_s > TOLERANCE_S and not stream.startswith(DRAWN_ANEW)
                agree &= not wrong
                name = f"{stream} #{number + 1}" if len(runs[0][stream]) > 1 else stream
                median_ms = values[len(values) // 2] * 1e3
                print(f"{name:<44} {key:<6} {median_ms:12.4f} {spread_s * 1e3:10.4f}{'  DIFFERS' if wrong else ''}")
    return agree


def main() -> int:
    """Run, print, judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--boxes", type=int, default=2, help="boxes side by side")
    parser.add_argument("--hogs", type=int, default=os.cpu_count() or 2)
    options = parser.parse_args()
    # A box in which modules must be compiled first has another history than all later ones.
    subprocess.run([sys.executable, "-m", "compileall", "-q", "netlab", "udp_mesh"], cwd=ROOT, check=True)
    runs, green = [], 0
    for number in (signal.SIGINT, signal.SIGTERM):  # Ctrl-C ends it early, and the runs so far are judged
        signal.signal(number, signal.default_int_handler)
    with hog(options.hogs), contextlib.suppress(KeyboardInterrupt):
        for number in range(options.runs):
            passed, took_s, found = run_once(options.boxes)
            green += passed
            runs.append(found)
            load = os.getloadavg()[0]
            print(f"run {number + 1}: {'green' if passed else 'RED'}, {took_s:.0f} s real, load {load:.1f}", flush=True)
    agree = compare(runs)
    print(f"\n{green} of {len(runs)} runs green beside {options.hogs} busy processes; streams agree: {agree}")
    return 0 if green == len(runs) == options.runs and agree else 1


if __name__ == "__main__":
    sys.exit(main())
