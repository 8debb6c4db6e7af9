"""User-Mode Linux: its command line. Pure."""

from __future__ import annotations

from pathlib import Path

from netlab.vm import modules
from netlab.vm.request import Clock


def command_line(
    kernel: Path, control: Path, *, memory_bytes: int, clock: Clock, start_ns: int, python: str = "python"
) -> list[str]:
    """The argument list that boots ``kernel`` over the host's root file system, read-only.

    Args:
        kernel: The User-Mode Linux executable.
        control: The box's control folder, with ``init.py`` and ``python`` in it; its path has no space.
        memory_bytes: The guest's memory.
        clock: ``VIRTUAL`` needs a kernel with CONFIG_UML_TIME_TRAVEL_SUPPORT.
        start_ns: What the virtual clock shows at boot, nanoseconds since 1970; unused in real time.
        python: Name of the interpreter's link in ``control``.
    """
    travel = ["time-travel=inf-cpu", f"time-travel-start={start_ns}"] if clock is Clock.VIRTUAL else []
    return [
        str(kernel),
        f"mem={memory_bytes >> 20}M",
        "root=none",
        "rootfstype=hostfs",
        "rootflags=/",
        "ro",
        f"init={control}/{python}",
        f"uml_dir={control}/uml",
        "con=null",
        "con0=null,fd:1",
        "ssl=null",
        "devtmpfs.mount=0",  # else it would hide a control folder below /dev/shm
        "quiet",
        "panic=-1",
        "random.trust_cpu=on",  # seeded by the host; nothing in the box makes entropy in virtual time
        *modules.boot_options(),
        *travel,
        "--",
        *init_arguments(control),
    ]


def init_arguments(control: Path) -> list[str]:
    """What the box's init, a Python interpreter, is started with."""
    return ["-I", "-S", "-B", f"{control}/init.py", str(control)]
