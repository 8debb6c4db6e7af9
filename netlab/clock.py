"""By which clock this machine lives: the real one, or the virtual one of a box that runs in virtual time."""

from __future__ import annotations

import os
import time


def clock_here() -> str:
    """``real`` or ``virtual``; a box tells its processes in NETLAB_VM_CLOCK."""
    return os.environ.get("NETLAB_VM_CLOCK", "real")


def begin_in_step() -> None:
    """In virtual time, sleep to the clock's next whole second; it takes no real time.

    The kernel's coarse timers tick every 10 ms. Labs that begin in step with them meet those timers alike, so that the
    same lab gives the same figures whatever ran before it in the box.
    """
    if clock_here() == "virtual":
        time.sleep(-time.monotonic() % 1.0)
