"""What processes print: line by line to a log file each, to their last words and, while recording, to the capture."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable
from pathlib import Path

from netlab.lab.process import Process

LineSink = Callable[[str, str, str], None]  # node, process, line


def watch_output(process: Process, fd: int, log_dir: Path, on_line: LineSink) -> None:
    """Read a process's output from now on until its end.

    Args:
        process: Its ``tail`` is kept, and ``read_output`` set to what reads all that has been printed so far.
        fd: The reading end of its output; closed at its end.
        log_dir: The log is ``<log_dir>/<node>/<process>.log``.
        on_line: Gets every line.
    """
    _Output(process, fd, log_dir, on_line)


class _Output:
    def __init__(self, process: Process, fd: int, log_dir: Path, on_line: LineSink) -> None:
        self._process = process
        self._fd = fd
        self._on_line = on_line
        self._pending = b""
        directory = log_dir / process.spec.node
        directory.mkdir(parents=True, exist_ok=True)
        self._log = (directory / f"{process.spec.name}.log").open("ab", buffering=0)
        os.set_blocking(fd, False)
        process.read_output = self._read_all
        asyncio.get_running_loop().add_reader(fd, self._read_some)

    def _read_all(self) -> None:
        while self._read_some():
            pass

    def _read_some(self) -> bool:
        """Read once; whether there may be more."""
        try:
            data = os.read(self._fd, 65536)
        except BlockingIOError:
            return False
        with contextlib.suppress(OSError):  # a full disk must not stop the lab
            self._log.write(data)
        *lines, self._pending = (self._pending + data).split(b"\n")
        if not data and self._pending:
            lines.append(self._pending)
        for line in lines:
            text = line.decode(errors="replace")
            self._process.tail.append(text)
            self._on_line(self._process.spec.node, self._process.spec.name, text)
        if not data:
            self._close()
        return bool(data)

    def _close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._fd)
        os.close(self._fd)
        self._log.close()
        self._process.read_output = lambda: None
