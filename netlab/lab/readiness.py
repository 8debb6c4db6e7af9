"""Waiting for processes: until they are ready, until they have ended."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence

from netlab.errors import LabError
from netlab.lab.process import Process, State

READY_LIMIT_S = 20.0


async def wait_ready(
    processes: Sequence[Process], limit_s: float, tell: Callable[[str], None] = lambda what: None
) -> None:
    """Return when all are ready; one that reports no readiness and came to a good end has done its work.

    ``tell`` hears how far it is.

    Raises:
        LabError: One ended first, or is not ready in time; with its argv, exit code and last log lines.
    """
    for number, process in enumerate(processes):
        tell(f"starting processes: {number} of {len(processes)} ready")
        if process.spec.waits_for_ready or process.exit_status != 0:
            await wait_for_state(process, State.READY, limit_s)


async def wait_for_state(process: Process, state: State, limit_s: float) -> None:
    """Return when a process has come into ``state``. Raises LabError when it ended instead, or at the limit."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(limit_s):
            while process.state is not state:
                if process.state is State.EXITED:
                    raise LabError(process.describe_failure())
                await process.changed.wait()
    if process.state is not state:
        raise LabError(f"not {state} within {limit_s:.0f} s: {process.describe_failure()}")
