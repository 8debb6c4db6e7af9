"""What our daemons and commands ask of the system they run in: exact timers, signals that end a loop, and an end
without noise."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
from collections.abc import Iterator
from typing import Protocol

_PR_SET_TIMERSLACK = 29


class Loop(Protocol):
    """A loop that :meth:`stop` ends as soon as a byte comes out of the other end of ``wake_write``."""

    wake_write: socket.socket

    def stop(self) -> None:
        """End at the next turn."""


@contextlib.contextmanager
def stopped_by_signals(loop: Loop) -> Iterator[None]:
    """Let SIGTERM and SIGINT end a loop, however long it sleeps."""

    def stop(_number: int, _frame: object) -> None:
        loop.stop()

    signal.set_wakeup_fd(loop.wake_write.fileno(), warn_on_full_buffer=False)
    try:
        signal.signal(signal.SIGTERM, stop)
        signal.signal(signal.SIGINT, stop)
        yield
    finally:
        signal.set_wakeup_fd(-1)


def tell_ready(descriptor: int | None) -> None:
    """Write to the descriptor of ``--ready-fd``, if there is one, that everything is open."""
    if descriptor is not None:
        os.write(descriptor, b"READY=1\n")
        os.close(descriptor)


def allow_exact_timers() -> None:
    """Ask the kernel not to delay our timers by the usual 50 us."""
    import ctypes  # here because it is only needed once, and costs milliseconds

    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


@contextlib.contextmanager
def ending_quietly() -> Iterator[None]:
    """Let Ctrl-C, and a reader of our output who has enough, end a command as if it were done."""
    try:
        yield
    except KeyboardInterrupt:
        pass
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115, PTH123 (the interpreter flushes it at its end)
