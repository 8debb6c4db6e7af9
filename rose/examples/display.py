"""The operator's display: one line a second about what the laser sees and how well it comes through."""

from __future__ import annotations

import asyncio
import math

import rose
from rose.core.reception import Sample
from rose.examples.messages import LaserScan
from rose.subscription import Subscription


class Display(rose.Program):
    """Prints; publishes nothing."""

    class Settings(rose.Settings):
        """``laser``: its service id."""

        laser: str
        every_s: float = 1.0

    async def run(self) -> None:
        """Print until cancelled."""
        scans = self.service.subscribe(self.settings.laser, LaserScan)
        try:
            while True:
                await asyncio.sleep(self.settings.every_s)
                print(line(scans, scans.take_latest()), flush=True)
        finally:
            self.service.unsubscribe(scans.sender)


def line(scans: Subscription[LaserScan], newest: Sample | None) -> str:
    """Say how it stands with a laser."""
    counters = scans.counters
    totals = f"{counters.delivered} scans, {counters.lost} lost, {counters.partial} in part"
    if newest is None:
        silent_s = scans.age_s()
        since = "never heard" if math.isinf(silent_s) else f"silent for {silent_s:.1f} s"
        return f"{scans.sender}: {since}; {totals}"
    assert isinstance(newest.message, LaserScan)
    seen = [distance for distance in newest.message.ranges_m if math.isfinite(distance)]
    nearest = f"nearest {min(seen):.2f} m" if seen else "nothing in sight"
    return f"{scans.sender}: {nearest}, {newest.completeness:.0%} of the beams; {totals}"
