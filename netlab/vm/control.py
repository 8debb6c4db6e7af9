"""The control folder of a box: the job that its init reads, and the files by which it answers."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from netlab.vm import guest, modules
from netlab.vm.fitness import INSIDE
from netlab.vm.kernels import LAB_MODULES, Emulator, Kernel
from netlab.vm.places import visible_paths
from netlab.vm.request import BoxRequest

CONSOLE = "console.log"
_TAIL_BYTES = 4000
_CHUNK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Status:
    """How the command ended, by the guest's account: its exit code and its duration on the guest's clock."""

    exit_code: int
    guest_s: float


def write_job(folder: Path, request: BoxRequest, kernel: Kernel, output: Path | None) -> None:
    """Fill a new control folder: the job, the init program and a link to the interpreter."""
    interpreter = Path(sys.base_prefix, "bin", f"python3.{sys.version_info.minor}")
    if not interpreter.exists():
        interpreter = Path(sys.executable).resolve()
    (folder / "python").symlink_to(interpreter)
    shutil.copy(guest.__file__, folder / "init.py")
    needed = [request.cwd, Path(sys.prefix), interpreter, Path(__file__), *([kernel.modules] if kernel.modules else [])]
    if os.sep in request.argv[0]:
        needed.append(request.cwd / request.argv[0])
    job = {
        "argv": list(request.argv),
        "env": {**request.env, INSIDE: "1", f"{INSIDE}_CLOCK": request.clock.value},
        "cwd": str(request.cwd),
        "output": None if output is None else str(output),
        "visible": visible_paths(needed),
        "shares": "hostfs" if kernel.emulator is Emulator.UML else "9p",
        "modules": None if kernel.modules is None else str(kernel.modules),
        "load_first": modules.load_order(kernel.modules, ["overlay"]),
        "load": modules.load_order(kernel.modules, LAB_MODULES),
        "soft_files": resource.getrlimit(resource.RLIMIT_NOFILE)[0],
    }
    (folder / "job.json").write_text(json.dumps(job))


def last_lines(log: Path, speaker: str) -> str:
    """What a log ends with, indented, for an error message."""
    with contextlib.suppress(OSError):
        text = log.read_bytes()[-_TAIL_BYTES:].decode(errors="replace")
        lines = [line.rstrip() for line in text.splitlines() if line.strip()][-12:]
        if lines:
            return f"{speaker} said:\n" + "\n".join(f"  {line}" for line in lines)
    return f"{speaker} said nothing."


class Answers:
    """Reads what the guest has written so far."""

    def __init__(self, folder: Path, streams: dict[str, BinaryIO]) -> None:
        self._folder = folder
        self._streams = streams
        self._sources: dict[str, BinaryIO] = {}

    @property
    def started(self) -> bool:
        """Whether the box's init runs and all is mounted."""
        return (self._folder / "up").exists()

    def status(self) -> Status | None:
        """How the command ended; None as long as it has not."""
        try:
            text = (self._folder / "status").read_text()
            return Status(**json.loads(text)) if text.endswith("\n") else None
        except OSError:
            return None

    def forward(self) -> None:
        """Copy new output of the command to the caller's streams."""
        for name, target in self._streams.items():
            source = self._source(name)
            while source is not None and (data := source.read(_CHUNK_BYTES)):
                target.write(data)
                target.flush()

    def console_tail(self) -> str:
        """The last lines of the kernel's console, indented, for an error message."""
        return last_lines(self._folder / CONSOLE, "The console")

    def close(self) -> None:
        """Close what was opened for reading; nothing is forwarded after that."""
        for source in self._sources.values():
            source.close()
        self._sources, self._streams = {}, {}

    def _source(self, name: str) -> BinaryIO | None:
        if name not in self._sources:
            with contextlib.suppress(FileNotFoundError):
                self._sources[name] = (self._folder / name).open("rb", buffering=0)
        return self._sources.get(name)
