"""Run time: seconds since a scenario's t = 0, which nothing stops."""

from __future__ import annotations

import asyncio
import time


class RunClock:
    """The clock of one run; ``t0_ns`` (CLOCK_REALTIME) is None until t = 0 is set, and may lie a little ahead then."""

    def __init__(self) -> None:
        self.t0_ns: int | None = None

    @property
    def t_s(self) -> float | None:
        """Run time, None before t = 0 is set."""
        return None if self.t0_ns is None else self.now_s

    @property
    def now_s(self) -> float:
        """Run time of a run whose t = 0 is set."""
        assert self.t0_ns is not None
        return (time.time_ns() - self.t0_ns) / 1e9

    async def sleep_until(self, at_s: float) -> None:
        """Return at a run time."""
        while (left_s := at_s - self.now_s) > 0:
            await asyncio.sleep(left_s)
