"""A command in a node on the user's terminal: a pseudo-terminal there, raw mode and a byte pump here."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import select
import selectors
import signal
import sys
import termios
import tty
from typing import Any

from netlab.lab.control import ControlClient

_LAST_OUTPUT_S = 0.1


def exec_with_terminal(connection: ControlClient, request: dict[str, Any]) -> int:
    """Run ``request`` (an ``exec``) on a pseudo-terminal joined to ours; returns its exit code."""
    ours, theirs = pty.openpty()
    _copy_window_size(ours)
    try:
        connection.request({**request, "tty": True}, [theirs, theirs, theirs])
    finally:
        os.close(theirs)
    saved = termios.tcgetattr(sys.stdin)
    previous = signal.signal(signal.SIGWINCH, lambda _signum, _frame: _copy_window_size(ours))
    try:
        tty.setraw(sys.stdin)
        _pump(connection, ours)
        status = int(connection.next_reply(timeout_s=5.0)["exit"])
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, saved)
        signal.signal(signal.SIGWINCH, previous)
        os.close(ours)
        connection.close()
    return status if status >= 0 else 128 - status


def _pump(connection: ControlClient, terminal: int) -> None:
    with selectors.DefaultSelector() as selector:
        selector.register(sys.stdin, selectors.EVENT_READ)
        selector.register(terminal, selectors.EVENT_READ)
        selector.register(connection, selectors.EVENT_READ)
        while True:
            ready = {key.fileobj for key, _events in selector.select()}
            if terminal in ready:
                try:
                    data = os.read(terminal, 65536)
                except OSError:  # EIO: every process on the other side is gone
                    return
                if not data:
                    return
                os.write(sys.stdout.fileno(), data)
            elif connection in ready:
                _drain(terminal)
                return
            if sys.stdin in ready:
                data = os.read(sys.stdin.fileno(), 65536)
                if data:
                    os.write(terminal, data)
                else:
                    selector.unregister(sys.stdin)


def _drain(terminal: int) -> None:
    """The command has ended; the kernel may still be handing over its last output."""
    with contextlib.suppress(OSError):  # EIO: the other side is closed and everything has been read
        while select.select([terminal], [], [], _LAST_OUTPUT_S)[0] and (data := os.read(terminal, 65536)):
            os.write(sys.stdout.fileno(), data)


def _copy_window_size(terminal: int) -> None:
    with contextlib.suppress(OSError):
        size = fcntl.ioctl(sys.stdin, termios.TIOCGWINSZ, b"\0" * 8)
        fcntl.ioctl(terminal, termios.TIOCSWINSZ, size)
