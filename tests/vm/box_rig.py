"""What tests of the box share: a kernel made of shell that answers as the real one does, and a look for remains."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass, field
from pathlib import Path

from netlab.vm.kernels import Emulator, Kernel
from netlab.vm.request import BoxRequest, BoxResult, Clock
from netlab.vm.run import Streams, run_in_box

#: The last word of the command line is the control folder, as for the real kernel.
PREAMBLE = "#!/bin/sh\nfor control; do :; done\n"
ANSWER = """
echo up >"$control/up"
printf 'to stdout\\n' >>"$control/stdout"
printf 'to stderr\\n' >>"$control/stderr"
printf '{"exit_code": 7, "guest_s": 1.5}\\n' >"$control/status"
"""


def fake_kernel(folder: Path, script: str) -> Kernel:
    """A kernel whose boot is this shell script; ``$control`` is the control folder."""
    path = folder / "fake-linux"
    path.write_text(PREAMBLE + script)
    path.chmod(0o755)
    return Kernel(Emulator.UML, path, "fake")


@dataclass
class Run:
    """A box with its output caught."""

    out: io.BytesIO = field(default_factory=io.BytesIO)
    err: io.BytesIO = field(default_factory=io.BytesIO)

    def box(
        self,
        *argv: str,
        kernel: Kernel,
        cwd: Path = Path("/"),
        output: Path | None = None,
        clock: Clock = Clock.VIRTUAL,
        timeout_s: float = 30.0,
        boot_limit_s: float = 20.0,
    ) -> BoxResult:
        env = {"PATH": "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin", "LC_ALL": "C.UTF-8"}
        request = BoxRequest(argv, cwd, env, output=output, clock=clock, memory_bytes=512 << 20, timeout_s=timeout_s)
        return run_in_box(request, Streams(self.out, self.err), kernel=kernel, boot_limit_s=boot_limit_s)


def alive(pid: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in ("Z", "X")
    except (FileNotFoundError, ProcessLookupError):
        return False


def with_word(word: str) -> list[int]:
    """Processes that have this word in their command line."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                words = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if word.encode() in words:
                found.append(int(entry.name))
    return found
