"""Compare netem, air and the pure medium; write the page that says so. Runs inside the box, in virtual time:

netlab vm --clock virtual --output docs -- python tests/agreement/agreement.py docs/agreement.md

Ends with 0 where all agree and every wrong medium is found out, 1 where not, 2 where it cannot run here.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from agreement_rig import through_engine, trial
from agreement_rig.cells import CELLS, scaled
from agreement_rig.page import page
from agreement_rig.trial import AIR

from netlab.clock import clock_here
from netlab.errors import MachineError

SEED = 7


def main() -> int:
    """Parse, run, write, judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path, help="the file to write, below the box's output folder")
    parser.add_argument(
        "--frames", type=int, help="at most so many per cell and phase: quick, and by its own judgement too weak"
    )
    options = parser.parse_args()
    if clock_here() != "virtual":
        print("agreement: delays are exact in virtual time only; start it as `make agreement` does", file=sys.stderr)
        return 2
    cells = CELLS if options.frames is None else tuple(scaled(cell, options.frames) for cell in CELLS)
    runs = {}
    try:
        for name in through_engine.ENGINES:
            print(f"agreement: {len(cells)} cells through {name}", file=sys.stderr)
            runs[name] = through_engine.run(name, cells, SEED)
    except MachineError as error:
        print(f"agreement: {error}", file=sys.stderr)
        return 2
    print("agreement: the medium, the samples and the media that are wrong", file=sys.stderr)
    tracks = {name: run.tracks for name, run in runs.items()}
    outcome = trial.compare(cells, tracks, seed=SEED, air_sending=runs[AIR].sending)
    options.page.write_text(page(outcome, os.uname().release, SEED), encoding="utf-8")
    for failure in outcome.failures:
        print(f"agreement: {failure}", file=sys.stderr)
    print(f"agreement: {options.page}: {'they differ' if outcome.failures else 'they agree'}", file=sys.stderr)
    return 1 if outcome.failures else 0


if __name__ == "__main__":
    sys.exit(main())
