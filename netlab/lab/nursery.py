"""Starts supervisors as forks of one process that has imported everything: for whoever starts many labs.

A supervisor's imports take a few tenths of a second of CPU time, in a kernel in a box seconds; a fork takes hundredths.
The process ends with the channel, that is, with its owner however that ends; its labs have lifelines of their own.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import select
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from netlab.errors import LabError
from netlab.ipc import Channel, start_module


@dataclass(frozen=True, slots=True)
class _Start:
    """Comes with the log's descriptor, then one for each of ``fd_options``."""

    arguments: tuple[str, ...]
    fd_options: tuple[str, ...]
    cwd: str
    env: dict[str, str]


class Forked:
    """A supervisor that a nursery started, with what :class:`subprocess.Popen` offers to whoever looks after it."""

    def __init__(self, pid: int, pidfd: int) -> None:
        self.pid = pid
        self._pidfd = pidfd
        self._is_over = False

    def poll(self) -> int | None:
        """None while it runs, else 0: the code itself is not to be had."""
        if not self._is_over and select.select([self._pidfd], [], [], 0)[0]:
            self._is_over = True
            os.close(self._pidfd)
        return 0 if self._is_over else None

    def wait(self, timeout: float | None = None) -> int:
        """Return when it has ended. Raises subprocess.TimeoutExpired."""
        if not self._is_over:
            select.select([self._pidfd], [], [], timeout)
        if self.poll() is None:
            raise subprocess.TimeoutExpired("the supervisor", timeout or 0.0)
        return 0

    def send_signal(self, signum: int) -> None:
        """Send a signal unless it has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._pidfd, signum)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)


class Nursery:
    """The owner's side. One request at a time."""

    def __init__(self) -> None:
        self._channel, self._pid = start_module("netlab.lab.nursery")

    def start(self, arguments: Sequence[str], fds: Mapping[str, int], log_fd: int) -> Forked:
        """Fork a supervisor in this process's folder and environment.

        Args:
            arguments: Of its command line.
            fds: Option -> descriptor that it inherits and whose number completes the command line.
            log_fd: Where its output goes.

        Raises:
            LabError: The nursery is gone.
        """
        request = _Start(tuple(arguments), tuple(fds), str(Path.cwd()), dict(os.environ))
        try:
            self._channel.send(request, [log_fd, *fds.values()])
            pid, (pidfd,) = self._channel.recv()
        except (EOFError, OSError) as error:
            raise LabError(f"the process that starts labs is gone: {error}") from error
        return Forked(pid, pidfd)

    def close(self) -> None:
        """End it; labs that it started live on."""
        self._channel.close()
        with contextlib.suppress(ChildProcessError):
            os.waitpid(self._pid, 0)


def main(argv: list[str]) -> int:
    """Fork a supervisor for every request until the channel closes."""
    from netlab.lab import supervisor  # noqa: F401 (what all the forks have in common)

    parser = argparse.ArgumentParser(prog="netlab-nursery")
    parser.add_argument("--channel-fd", type=int, required=True)
    channel = Channel.from_fd(parser.parse_args(argv).channel_fd)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the owner's terminal, and meant for the owner
    signal.signal(signal.SIGCHLD, _reap)
    gc.collect()
    gc.freeze()
    while True:
        try:
            request, fds = channel.recv()
        except EOFError:
            return 0
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})  # it must not be reaped before it can be named
        pid = os.fork()
        if pid == 0:
            _be_supervisor(request, fds, channel)
        pidfd = os.pidfd_open(pid)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
        channel.send(pid, [pidfd])
        for fd in (pidfd, *fds):
            os.close(fd)


def _reap(_signum: int, _frame: object) -> None:
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _be_supervisor(request: _Start, fds: list[int], channel: Channel) -> NoReturn:
    code = 70  # EX_SOFTWARE, should not even main() return
    try:
        from netlab.lab import supervisor

        channel.close()
        os.setsid()
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
        log_fd, *rest = fds
        with Path(os.devnull).open("rb") as nothing:
            os.dup2(nothing.fileno(), 0)
        for fd in (1, 2):
            os.dup2(log_fd, fd)
        os.close(log_fd)
        os.chdir(request.cwd)
        os.environ.clear()
        os.environ.update(request.env)
        time.tzset()
        options = [text for option, fd in zip(request.fd_options, rest, strict=True) for text in (option, str(fd))]
        code = supervisor.main([*request.arguments, *options])
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
