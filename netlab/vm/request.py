"""What a caller asks of a box and what comes back: plain values, no I/O."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from netlab.errors import MachineError

#: Exit code for a command that the host's time limit ended, as timeout(1) has it.
TIMED_OUT = 124

#: Exit code for a box that cannot start, as for every unfit machine.
UNFIT = 2

MIN_MEMORY_BYTES = 128 << 20
_MEMORY = re.compile(r"(?P<number>[0-9]+)(?P<unit>[MG])(?:iB|B)?", re.IGNORECASE)
_UNIT_SHIFT = {"M": 20, "G": 30}

#: What a command keeps of the caller's environment; all else (credentials, sockets, descriptors) stays outside.
_KEPT_NAMES = frozenset(
    {"HOME", "USER", "LOGNAME", "LANG", "LANGUAGE", "TERM", "COLUMNS", "LINES", "TZ", "VIRTUAL_ENV", "CI", "NO_COLOR"}
)
_KEPT_PREFIXES = ("LC_", "PYTEST_", "PYTHON", "NETLAB_", "UDP_MESH_", "HYPOTHESIS_")
_SBIN = "/usr/local/sbin:/usr/sbin:/sbin"


class BoxError(MachineError):
    """The box could not start, or broke before its command ended; the text names the way out."""


class Clock(StrEnum):
    """Which clock rules inside the box."""

    REAL = "real"
    VIRTUAL = "virtual"


class KernelChoice(StrEnum):
    """Which kernel the caller wants."""

    AUTO = "auto"
    UML = "uml"  # the built one; in real time Debian's ready package where nothing is built
    DEBIAN = "debian"  # Debian's user-mode-linux package
    QEMU = "qemu"  # Debian's stock kernel in QEMU


@dataclass(frozen=True, slots=True)
class BoxRequest:
    """One command in one throw-away kernel.

    Attributes:
        argv: The command; found on the PATH in ``env`` unless it holds a slash.
        cwd: Absolute; the same path inside.
        env: The environment of the command, see :func:`clean_environment`; the box adds NETLAB_VM and NETLAB_VM_CLOCK.
        output: Absolute folder that is writable through to the host, at the same path inside; None for none.
        kernel: Which kernel.
        clock: Which clock.
        memory_bytes: Of the guest, at least 128 MiB; the host spends only what is touched.
        timeout_s: Hard limit on the host's clock, boot included, > 0.
    """

    argv: tuple[str, ...]
    cwd: Path
    env: dict[str, str] = field(default_factory=dict)
    output: Path | None = None
    kernel: KernelChoice = KernelChoice.AUTO
    clock: Clock = Clock.REAL
    memory_bytes: int = 2 << 30
    timeout_s: float = 600.0

    def __post_init__(self) -> None:
        if not self.argv:
            raise ValueError("a box needs a command")
        if self.timeout_s <= 0:
            raise ValueError(f"the time-out is {self.timeout_s} s; it must be positive")
        if self.memory_bytes < MIN_MEMORY_BYTES:
            raise ValueError(f"{self.memory_bytes} bytes of memory are too few; at least {MIN_MEMORY_BYTES}")


@dataclass(frozen=True, slots=True)
class BoxResult:
    """How a command in a box ended.

    Attributes:
        exit_code: The command's; 128 + n if signal n ended it; ``TIMED_OUT`` if the time limit did.
        kernel: The kernel that ran it, for people.
        boot_s: Real seconds from the start to the first instruction of the box's init.
        wall_s: Real seconds in all.
        guest_s: Seconds that the command took by the clock inside; None if it did not end.
        notes: What the person should know (a fallback that was taken), one sentence each.
    """

    exit_code: int
    kernel: str
    boot_s: float
    wall_s: float
    guest_s: float | None
    notes: tuple[str, ...] = ()

    @property
    def timed_out(self) -> bool:
        """Whether the host's time limit ended the box."""
        return self.guest_s is None


def parse_memory(text: str) -> int:
    """Bytes in ``512M`` or ``2G`` (binary units).

    Raises:
        ValueError: No such quantity, or under 128M.
    """
    match = _MEMORY.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"{text!r} is no amount of memory; write 512M or 2G")
    size_bytes = int(match["number"]) << _UNIT_SHIFT[match["unit"].upper()]
    if size_bytes < MIN_MEMORY_BYTES:
        raise ValueError(f"{text} is too little memory for a box; at least 128M")
    return size_bytes


def clean_environment(env: dict[str, str], *, extra: dict[str, str] | None = None) -> dict[str, str]:
    """What of ``env`` a command in the box keeps, and ``extra`` on top; the system's sbin folders end the PATH."""
    kept = {name: value for name, value in env.items() if name in _KEPT_NAMES or name.startswith(_KEPT_PREFIXES)}
    path = env.get("PATH") or "/usr/local/bin:/usr/bin:/bin"
    return {**kept, "PATH": f"{path}:{_SBIN}", **(extra or {})}
