"""By which clock this machine lives: the real one, or the virtual one of a box that runs in virtual time."""

from __future__ import annotations

import os


def clock_here() -> str:
    """``real`` or ``virtual``; a box tells its processes in NETLAB_VM_CLOCK."""
    return os.environ.get("NETLAB_VM_CLOCK", "real")
