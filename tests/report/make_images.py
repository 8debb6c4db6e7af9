"""Makes the pictures of docs/report.md: runs scenarios in virtual time, writes their reports, takes the pictures.

    python tests/report/make_images.py [FOLDER]        default: docs/images

Needs chromium, matplotlib and a box (`netlab vm build`). Some minutes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from netlab.report.build import write_report  # noqa: E402
from tests.report.headless_browser import Browser, chromium  # noqa: E402

WIDTH, WIDE = 1000, 1360
COLOURS = 128  # enough for a page of plots, and a third of the size


@dataclass(frozen=True, slots=True)
class Shot:
    """One picture: of which report, which part of it (None: its top), and how."""

    name: str
    report: str
    selector: str | None
    dark: bool = False
    width: int = WIDTH


RUNS: dict[str, Sequence[str]] = {
    "corner": (),
    "outage": (),
    "flapping": (),
    "beacon_drop": (),
    "bottleneck": (),
    "no_priorities": ("--set", "udp_mesh.prioritise=false"),
}
SCENARIOS = {"no_priorities": "bottleneck"}
SHOTS = (
    Shot("report", "corner", None),
    Shot("report-latency-dark", "corner", "#latency", dark=True),
    Shot("report-message", "outage", "#message"),
    Shot("report-relays", "beacon_drop", "#message"),
    Shot("report-reconnects", "flapping", "#reconnects"),
    Shot("report-map", "corner", "#map"),
    Shot("report-compared", "compared", "#distribution", width=WIDE),
)


def run(name: str, folder: Path) -> Path:
    """Run a scenario; returns its capture."""
    capture = folder / f"{name}.mcap"
    scenario = ROOT / "topologies" / f"{SCENARIOS.get(name, name)}.yaml"
    words = ["run", str(scenario), "--in", "vm", "--clock", "virtual", "--capture", str(capture), *RUNS[name]]
    done = subprocess.run(
        [sys.executable, "-m", "netlab", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if not capture.exists():
        sys.exit(f"{name}: {done.stderr or done.stdout}")
    return capture


def main(folder: Path) -> None:
    """Make all pictures in a folder."""
    program = chromium()
    if program is None:
        sys.exit("no chromium is installed: sudo apt-get install chromium")
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch, Browser(program) as browser:
        captures = {name: run(name, Path(scratch)) for name in RUNS}
        pages = {name: write_report(path, Path(scratch) / name) for name, path in captures.items()}
        pages["compared"] = write_report(
            captures["bottleneck"], Path(scratch) / "compared", other=captures["no_priorities"]
        )
        for shot in SHOTS:
            target = folder / f"{shot.name}.png"
            browser.show(pages[shot.report], width=shot.width, height=1180, dark=shot.dark)
            browser.picture(target, selector=shot.selector, whole=shot.selector is not None)
            with Image.open(target) as picture:
                picture.convert("P", palette=Image.Palette.ADAPTIVE, colors=COLOURS).save(target, optimize=True)
            print(f"{target}: {target.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "images")
