"""Start a supervisor from a user's process and wait until its lab is ready."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from netlab.errors import CaptureError, LabError, MachineError
from netlab.lab import registry
from netlab.lab.control import ControlClient
from netlab.lab.nursery import Forked, Nursery
from netlab.scenario.model import Scenario

START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True)
class LaunchOptions:
    """How to run a scenario, whose source ``scenario_text`` goes into the capture with the ``overrides`` of its keys.

    ``capture`` is where the MCAP goes (absolute), None for no recording at all; ``packets`` also records every packet
    and radio verdict. A lab in the ``background`` outlives the process that started it. ``keep_visible`` are
    directories that the node's processes must see although they lie below a private directory such as /tmp.
    """

    engine: str = "auto"
    scenario_text: str = ""
    overrides: tuple[str, ...] = ()
    capture: Path | None = None
    packets: bool = True
    background: bool = False
    keep_visible: tuple[Path, ...] = ()


#: Told what is being done while a lab comes up.
OnStage = Callable[[str], None]


class LabProcess:
    """A running supervisor."""

    def __init__(
        self, folder: registry.LabFolder, process: subprocess.Popen[bytes] | Forked, lifeline: int | None
    ) -> None:
        self.folder = folder
        self._process = process
        self._lifeline = lifeline

    @property
    def pid(self) -> int:
        """The outer process; ending it ends the lab."""
        return self._process.pid

    def connect(self) -> ControlClient:
        """A new control connection."""
        return ControlClient(self.folder.control_socket)

    def stop(self) -> None:
        """End the lab and wait until nothing of it is left."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._lifeline is not None:
            with contextlib.suppress(OSError):
                os.close(self._lifeline)
            self._lifeline = None
        registry.running()  # removes the folder of the lab that just ended


def make_room(capture: Path) -> None:
    """Make the folder that a capture goes into.

    Raises:
        CaptureError: It cannot be made.
    """
    try:
        capture.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CaptureError(f"{capture}: its folder cannot be made: {error.strerror}") from None


def launch(
    scenario: Scenario,
    options: LaunchOptions,
    nursery: Nursery | None = None,
    on_stage: OnStage = lambda what: None,
) -> LabProcess:
    """Start a lab and return when every interface is up and every process has reported ready.

    Args:
        scenario: What to run.
        options: How.
        nursery: Starts the supervisor as a fork, for whoever starts many labs.
        on_stage: Told what is being done meanwhile.

    Raises:
        MachineError: This machine cannot run it; the text names the way out.
        LabError: A process could not start; the text holds its argv, exit code and last log lines.
    """
    folder, lock_fd = registry.create(scenario.name)
    fds = {"--lock-fd": lock_fd}
    lifeline_write = None
    try:
        (folder.path / "scenario.pickle").write_bytes(pickle.dumps((scenario, options)))
        ready_read, fds["--ready-fd"] = os.pipe()
        if not options.background:
            fds["--lifeline-fd"], lifeline_write = os.pipe()
        with (folder.path / "supervisor.log").open("ab") as log:
            arguments = ["--folder", str(folder.path)]
            process = (nursery.start if nursery is not None else _execute)(arguments, fds, log.fileno())
    finally:
        for fd in fds.values():
            os.close(fd)
    lab = LabProcess(folder, process, lifeline_write)
    try:
        _wait_ready(lab, ready_read, on_stage)
    except BaseException:
        lab.stop()
        raise
    finally:
        os.close(ready_read)
    return lab


def _execute(arguments: Sequence[str], fds: Mapping[str, int], log_fd: int) -> subprocess.Popen[bytes]:
    options = [text for option, fd in fds.items() for text in (option, str(fd))]
    return subprocess.Popen(
        [sys.executable, "-m", "netlab.lab.supervisor", *arguments, *options],
        stdin=subprocess.DEVNULL,
        stdout=log_fd,
        stderr=log_fd,
        pass_fds=tuple(fds.values()),
        start_new_session=True,
    )


def _wait_ready(lab: LabProcess, ready_fd: int, on_stage: OnStage) -> None:
    deadline = time.monotonic() + START_TIMEOUT_S
    data = b""
    while True:
        if not select.select([ready_fd], [], [], max(0.0, deadline - time.monotonic()))[0]:
            raise LabError(f"the lab was not ready within {START_TIMEOUT_S:.0f} s; its log: {log_tail(lab.folder)}")
        part = os.read(ready_fd, 65536)
        if not part:
            raise LabError(f"the lab's supervisor ended before the lab was ready; its log: {log_tail(lab.folder)}")
        *lines, data = (data + part).split(b"\n")
        for answer in map(json.loads, lines):
            if "stage" not in answer:
                _check(answer)
                return
            on_stage(answer["stage"])


def _check(answer: dict[str, str]) -> None:
    if "error" in answer:
        raise (MachineError if answer["kind"] == "machine" else LabError)(answer["error"])


def log_tail(folder: registry.LabFolder) -> str:
    """The last lines of the supervisor's and its helpers' own output, for a person."""
    try:
        lines = (folder.path / "supervisor.log").read_text(errors="replace").splitlines()
    except OSError:
        return "(none)"
    return "\n    ".join(lines[-15:]) or "(empty)"
