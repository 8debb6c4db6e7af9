"""Runs one command in a throw-away kernel: prepare, boot, forward its output, judge how it ended, leave nothing."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from netlab.vm import fitness, kernels, places, qemu, uml
from netlab.vm.control import CONSOLE, Answers, Status, write_job
from netlab.vm.keeper import NAMESPACE, PLAIN
from netlab.vm.kernels import Emulator, Kernel
from netlab.vm.request import TIMED_OUT, BoxError, BoxRequest, BoxResult

#: A guest that has not come up by then hangs; measured: 2 to 5 s, in QEMU's emulation 10 to 30 s.
BOOT_LIMIT_S = {Emulator.UML: 45.0, Emulator.QEMU: 120.0}

#: The command has ended and its exit code is known; a guest that cannot power off is killed after this.
POWER_OFF_LIMIT_S = 10.0

#: Waiting for the keeper, which only kills and removes.
_KEEPER_LIMIT_S = 20.0
_POLL_S = 0.02


@dataclass(frozen=True, slots=True)
class Streams:
    """Where the command's output goes; both are flushed after every write."""

    stdout: BinaryIO
    stderr: BinaryIO


def run_in_box(
    request: BoxRequest,
    streams: Streams | None = None,
    *,
    kernel: Kernel | None = None,
    boot_limit_s: float | None = None,
) -> BoxResult:
    """Run a command in a throw-away kernel over the host's own root file system, to its end.

    The command runs as root of the guest; what it may read and write of the host is what the caller may. All that it
    writes is lost, except below ``request.output``.

    Args:
        request: The command and its box.
        streams: For its output; this process's own by default.
        kernel: Instead of the one that ``request`` would select.
        boot_limit_s: Instead of ``BOOT_LIMIT_S``.

    Raises:
        BoxError: The box cannot start, or broke before the command ended.
    """
    with open_box(request, streams, kernel=kernel, boot_limit_s=boot_limit_s) as box:
        return box.result()


@contextlib.contextmanager
def open_box(
    request: BoxRequest,
    streams: Streams | None = None,
    *,
    kernel: Kernel | None = None,
    boot_limit_s: float | None = None,
) -> Iterator[Box]:
    """Start a command as :func:`run_in_box` does, and go on beside it; leaving the block ends the box.

    Raises:
        BoxError: The box cannot start.
    """
    fitness.check_outside()
    output = places.check_output(request.output)
    chosen = kernel or kernels.select(request.kernel, request.clock)
    if chosen.emulator is Emulator.UML:
        fitness.check_uml()
    memory, notes = places.choose(places.candidates(), request.memory_bytes)
    places.sweep(memory, now_s=time.time())
    with _control_folder(memory) as (folder, held):
        write_job(folder, request, chosen, output)
        argv = [PLAIN if chosen.guests_die else NAMESPACE, *_command_line(chosen, folder, request, output)]
        limit_s = BOOT_LIMIT_S[chosen.emulator] if boot_limit_s is None else boot_limit_s
        limits = _Limits(boot_s=min(limit_s, request.timeout_s), end_s=request.timeout_s)
        box = Box(folder, argv, streams or Streams(sys.stdout.buffer, sys.stderr.buffer), held, limits, chosen, notes)
        try:
            yield box
        finally:
            box.close()


@contextlib.contextmanager
def _control_folder(memory: Path) -> Iterator[tuple[Path, int]]:
    """A new control folder and the descriptor that marks it as in use."""
    folder = places.make_control_folder(memory)
    held = places.hold(folder)
    try:
        yield folder, held
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(held)


def _command_line(kernel: Kernel, folder: Path, request: BoxRequest, output: Path | None) -> list[str]:
    if kernel.emulator is Emulator.QEMU:
        return qemu.prepare(kernel, folder, memory_bytes=request.memory_bytes, output=output)
    return uml.command_line(
        kernel.path, folder, memory_bytes=request.memory_bytes, clock=request.clock, start_ns=time.time_ns()
    )


@dataclass(frozen=True, slots=True)
class _Limits:
    """Seconds of the host's clock since the start."""

    boot_s: float
    end_s: float


class Box:
    """A box under way, from the host's side. Nothing need be called for the command to go on."""

    def __init__(
        self,
        folder: Path,
        argv: list[str],
        streams: Streams,
        held: int,
        limits: _Limits,
        kernel: Kernel,
        notes: tuple[str, ...],
    ) -> None:
        self._began_s = time.monotonic()
        self._limits = limits
        self._kernel = kernel
        self._notes = (*kernel.notes, *notes)
        self._boot_s: float | None = None
        self._answers = Answers(folder, {"stdout": streams.stdout, "stderr": streams.stderr})
        keeper = [sys.executable, "-m", "netlab.vm.keeper", str(folder), *argv]
        with (folder / CONSOLE).open("wb") as console:
            self._keeper = subprocess.Popen(
                keeper,
                stdin=subprocess.PIPE,
                stdout=console,
                stderr=subprocess.STDOUT,
                cwd=_package_root(),
                pass_fds=(held,),
            )

    def wait(self, condition: Callable[[], bool]) -> bool:
        """Forward output until the condition holds; False when the command has ended, or was out of time, without it.

        Raises:
            BoxError: The box does not start.
        """
        self._boot()
        self._wait(lambda: condition() or self._answers.status() is not None, self._limits.end_s)
        return condition()

    def result(self) -> BoxResult:
        """Wait for the command's end, or its time limit's, and end the box.

        Raises:
            BoxError: The box does not start, or broke before the command ended.
        """
        try:
            boot_s = self._boot()
            status = self._serve()
        finally:
            self.close()
        code = TIMED_OUT if status is None else status.exit_code
        guest_s = None if status is None else status.guest_s
        return BoxResult(code, self._kernel.label, boot_s, self._elapsed_s, guest_s, self._notes)

    def close(self) -> None:
        """End the box, whatever it is doing; idempotent."""
        self._end()
        self._answers.forward()
        self._answers.close()

    @property
    def ended(self) -> bool:
        """Whether the command has ended, or the box broke down."""
        return self._answers.status() is not None or self._keeper.poll() is not None

    @property
    def _elapsed_s(self) -> float:
        return time.monotonic() - self._began_s

    def _boot(self) -> float:
        """Wait until the guest's init runs; returns how long that took."""
        if self._boot_s is None:
            limit_s = self._limits.boot_s
            if not self._wait(lambda: self._answers.started, limit_s):
                code = self._keeper.poll()
                how = f"did not start within {limit_s:g} s" if code is None else f"ended at once (exit code {code})"
                self._end()
                raise BoxError(f"the box ({self._kernel.label}) {how}. {self._answers.console_tail()}")
            self._boot_s = self._elapsed_s
        return self._boot_s

    def _serve(self) -> Status | None:
        """Forward output until the command ends; None if the time limit ended it."""
        self._wait(lambda: self._answers.status() is not None, self._limits.end_s)
        status = self._answers.status()
        if status is None and self._keeper.poll() is not None:
            code = self._keeper.returncode
            raise BoxError(
                f"the box broke down before its command ended (exit code {code}). {self._answers.console_tail()}"
            )
        if status is not None:
            self._wait(lambda: False, self._elapsed_s + POWER_OFF_LIMIT_S)
        return status

    def _wait(self, condition: Callable[[], bool], until_s: float) -> bool:
        """Forward output until the condition holds, the box ends or the clock reaches ``until_s``."""
        while True:
            met = condition()
            self._answers.forward()
            if met or self._keeper.poll() is not None or self._elapsed_s >= until_s:
                return met or condition()
            time.sleep(_POLL_S)

    def _end(self) -> None:
        """Cut the lifeline: the keeper kills what is left and goes. Idempotent."""
        assert self._keeper.stdin is not None
        self._keeper.stdin.close()
        try:
            self._keeper.wait(_KEEPER_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._keeper.kill()
            self._keeper.wait()


def _package_root() -> Path:
    return Path(__file__).resolve().parents[2]
