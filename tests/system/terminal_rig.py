"""A pseudo-terminal with a person at it: keys in, the screen as it would look out (pyte emulates the terminal)."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import select
import signal
import struct
import termios
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pyte

KEYS = {"right": "\x1b[C", "left": "\x1b[D", "up": "\x1b[A", "down": "\x1b[B", "enter": "\r", "escape": "\x1b"}


class Terminal:
    """A program on a terminal of its own; closing it hangs up."""

    def __init__(
        self, argv: Sequence[str], *, cwd: Path, env: Mapping[str, str], columns: int = 120, lines: int = 38
    ) -> None:
        self._screen = pyte.Screen(columns, lines)
        self._stream = pyte.ByteStream(self._screen)
        self.raw = b""
        self.pid, self._fd = pty.fork()
        if self.pid == 0:
            os.chdir(cwd)
            os.execve(argv[0], list(argv), {**env, "TERM": "xterm-256color", "COLORTERM": "truecolor"})
        fcntl.ioctl(self._fd, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        self.status: int | None = None

    @property
    def lines(self) -> list[str]:
        """The screen, line by line."""
        return [line.rstrip() for line in self._screen.display]

    @property
    def text(self) -> str:
        """The screen as one text."""
        return "\n".join(self.lines)

    def press(self, *keys: str) -> None:
        """Press keys by their names, or type a text."""
        for key in keys:
            os.write(self._fd, KEYS.get(key, key).encode())
            self._read(0.05)

    def click(self, column: int, row: int) -> None:
        """Press and release the left button (SGR mouse report; from 0)."""
        for end in ("M", "m"):
            os.write(self._fd, f"\x1b[<0;{column + 1};{row + 1}{end}".encode())
        self._read(0.05)

    def find(self, text: str, *, left_of: int | None = None) -> tuple[int, int]:
        """Where a text stands: (column, row); only left of a column, if one is given."""
        for row, line in enumerate(self.lines):
            if text in line[:left_of]:
                return line.index(text), row
        raise AssertionError(f"{text!r} is not on the screen:\n{self.text}")

    def until(self, condition: str | Callable[[str], bool], *, within_s: float = 40.0) -> str:
        """Read until a text is on the screen, or a condition on the screen holds; returns the screen."""
        holds = (lambda screen: condition in screen) if isinstance(condition, str) else condition
        deadline = time.monotonic() + within_s
        while not holds(self.text):
            if not self._read(0.2) and self.status is not None:
                raise AssertionError(f"it ended with {self.status} before {condition!r}: {self.raw[-300:]!r}")
            assert time.monotonic() < deadline, f"never came: {condition!r}\n{self.text}"
        return self.text

    def settle(self) -> None:
        """Read for as long as a person needs between two keys: what the last one did has been done then."""
        deadline = time.monotonic() + 0.5
        while (left_s := deadline - time.monotonic()) > 0:
            self._read(left_s)

    def end(self, *, within_s: float = 30.0) -> int:
        """Wait for its end; returns the exit code."""
        deadline = time.monotonic() + within_s
        while self.status is None:
            self._read(0.1)
            assert time.monotonic() < deadline, f"it does not end:\n{self.text}"
        return self.status

    def close(self) -> None:
        """Hang up, and make sure that it is gone."""
        if self.status is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        os.close(self._fd)

    def _read(self, wait_s: float) -> bool:
        """Take in what it has written; False when it wrote nothing."""
        if self.status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.status = os.waitstatus_to_exitcode(status) if pid else None
        if not select.select([self._fd], [], [], wait_s)[0]:
            return False
        try:
            data = os.read(self._fd, 65536)
        except OSError:  # EIO: every process on the terminal is gone
            return False
        self.raw += data
        self._stream.feed(data)
        return bool(data)
