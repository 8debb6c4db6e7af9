"""The priority of a process that carries the lab's frames."""

from __future__ import annotations

import contextlib
import os
import resource

from netlab.kernel import syscalls


def prefer_this_process() -> None:
    """Real-time priority where the user may have it: a busy machine then costs microseconds, not time slices."""
    syscalls.set_timerslack_ns(1)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    except OSError:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, -20)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
