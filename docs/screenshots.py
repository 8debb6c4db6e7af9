"""Take the screenshots of the documentation: `python docs/screenshots.py` writes docs/*.svg.

Each is the real application around a real lab, driven by keys on a screen of Textual's own.
"""

from __future__ import annotations

import asyncio
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

from netlab.lab.facade import Lab
from netlab.tui.app import LabApp
from netlab.tui.screen import MainScreen
from netlab.tui.session import LabSession

HERE = Path(__file__).parent
TOPOLOGIES = HERE.parent / "topologies"
#: Name, scenario, run time in seconds at which the keys are pressed, keys.
SHOTS: Sequence[tuple[str, str, float, Sequence[str]]] = (
    ("lab", "beacon_drop", 48.0, ("right", "right")),
    ("lab-cut", "default", 14.0, ("down", "down", "c", "question_mark", "enter", "right", "down")),
)
SIZE = (124, 40)


async def shoot(scenario: Path, at_s: float, keys: Sequence[str], folder: Path) -> str:
    """The screen a little after the keys, as SVG."""
    app = LabApp(lambda path: LabSession(Lab(path, capture=folder / f"{path.stem}.mcap")), scenario, captures=folder)
    try:
        async with app.run_test(size=SIZE) as pilot:
            while not (isinstance(app.screen, MainScreen) and (app.screen.standing.t_s or 0.0) >= at_s):
                await pilot.pause(0.2)
            for key in keys:
                await pilot.press(key)
                await pilot.pause(0.8)
            await pilot.pause(2.0)
            return app.export_screenshot(title=f"netlab lab {scenario.name}")
    finally:
        if app.session is not None:
            app.session.close()


def self_contained(svg: str) -> str:
    """Without fonts from the network: the reader's own monospaced one is used."""
    svg = re.sub(r"@font-face\s*\{.*?\}", "", svg, flags=re.DOTALL)
    return re.sub(r"[ \t]+$", "", svg.replace("Fira Code", "DejaVu Sans Mono"), flags=re.MULTILINE)


def main() -> None:
    """Take all of them."""
    for name, scenario, at_s, keys in SHOTS:
        with tempfile.TemporaryDirectory() as folder:
            svg = asyncio.run(shoot(TOPOLOGIES / f"{scenario}.yaml", at_s, keys, Path(folder)))
        (HERE / f"{name}.svg").write_text(self_contained(svg))
        print(f"{HERE / name}.svg")


if __name__ == "__main__":
    main()
