"""A machine that stands still is noticed; a virtual clock never does."""

from __future__ import annotations

import asyncio
import time

import pytest

from netlab.lab.stalls import INTERVAL_S, StallWatch


async def _watch_while_blocked(watch: StallWatch, blocked_s: float) -> None:
    task = asyncio.create_task(watch.run())
    await asyncio.sleep(0)
    time.sleep(INTERVAL_S + blocked_s)  # the loop stands still, as it does when the machine does
    await asyncio.sleep(INTERVAL_S)
    task.cancel()


def test_the_longest_stall_is_kept() -> None:
    watch = StallWatch()
    asyncio.run(_watch_while_blocked(watch, 0.06))
    first_s = watch.worst_s
    assert first_s >= 0.06
    asyncio.run(_watch_while_blocked(watch, 0.0))
    assert watch.worst_s >= first_s


def test_in_virtual_time_nothing_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NETLAB_VM_CLOCK", "virtual")
    watch = StallWatch()
    asyncio.run(_watch_while_blocked(watch, 0.01))
    assert watch.worst_s == 0.0
