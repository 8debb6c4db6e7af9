"""What a box needs of this machine, tried rather than assumed."""

from __future__ import annotations

import ctypes
import os
import platform
from pathlib import Path

from netlab.vm.request import BoxError

_PTRACE_TRACEME = 0
_YAMA = Path("/proc/sys/kernel/yama/ptrace_scope")
#: Set to 1 in the environment of every command in a box; with ``_CLOCK`` behind it: ``real`` or ``virtual``.
INSIDE = "NETLAB_VM"


def ptrace_problem() -> int:
    """0 if a child of this process may be traced, else the errno of the refusal. Tried in a child."""
    libc = ctypes.CDLL(None, use_errno=True)
    pid = os.fork()
    if pid == 0:
        refused = libc.ptrace(ctypes.c_long(_PTRACE_TRACEME), 0, None, None) < 0
        os._exit((ctypes.get_errno() or 255) if refused else 0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def explain_no_ptrace(number: int, yama: Path = _YAMA) -> str:
    """Why User-Mode Linux cannot trace its processes here, and what allows it."""
    why = f"User-Mode Linux runs its processes under ptrace, which this machine refuses ({os.strerror(number)})"
    scope = yama.read_text().strip() if yama.exists() else "0"
    if scope in ("2", "3"):
        change = "sudo sysctl -w kernel.yama.ptrace_scope=1" + (" after a reboot" if scope == "3" else "")
        return f"{why}: kernel.yama.ptrace_scope is {scope}. To allow it: {change}; or use --kernel qemu."
    return (
        f"{why}: most likely a container's seccomp filter. Start the container with --cap-add SYS_PTRACE or "
        "--security-opt seccomp=unconfined; or use --kernel qemu."
    )


def check_uml() -> None:
    """Refuse where User-Mode Linux cannot work.

    Raises:
        BoxError: Another architecture, no ptrace, or already inside a box.
    """
    check_outside()
    if platform.machine() != "x86_64":
        raise BoxError(f"User-Mode Linux needs an x86_64 machine; this is {platform.machine()}. Use --kernel qemu.")
    number = ptrace_problem()
    if number:
        raise BoxError(explain_no_ptrace(number))


def check_outside() -> None:
    """Refuse a box inside a box.

    Raises:
        BoxError: This is the inside of one.
    """
    if os.environ.get(INSIDE):
        raise BoxError("this command runs inside a box already; run the command itself instead of `netlab vm`")
