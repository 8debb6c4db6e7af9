"""Whether the machine kept up: the longest time for which it, or the lab's own supervisor, stood still during a run."""

from __future__ import annotations

import asyncio
import time

from netlab.clock import clock_here

INTERVAL_S = 0.02
NOTABLE_S = 0.05  # from here on figures of time say as much about the machine as about the network


class StallWatch:
    """Measures how late a regular timer fires. Daemons and air wait for the same processors, and so are as late.

    In virtual time nothing is ever late and nothing is measured.
    """

    def __init__(self) -> None:
        self.worst_s = 0.0

    async def run(self) -> None:
        """Watch until cancelled."""
        if clock_here() == "virtual":
            return
        while True:
            due_s = time.monotonic() + INTERVAL_S
            await asyncio.sleep(INTERVAL_S)
            self.worst_s = max(self.worst_s, time.monotonic() - due_s)
