"""The walls around one lab: its own user (if not root), mount, PID, network, IPC and UTS namespaces.

Theory. The outer process unshares and forks; the child is PID 1 of the lab. Everything the lab creates is reachable
only through PID 1 and its children, so when PID 1 dies, however it dies, the kernel kills the rest and takes the
namespaces with them. PID 1 dies with the outer process: the parent-death signal reaches it because it comes from an
ancestor namespace. The outer process ends when its owner does (``lifeline_fd``), even by SIGKILL.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import signal
import traceback
from collections.abc import Callable
from pathlib import Path

from netlab.errors import MachineError
from netlab.kernel import syscalls
from netlab.kernel.probe import explain_userns_denied

STOP_LIMIT_S = 4
GRACE_S = 0.6  # nothing of a lab may be left a second after its owner's death

_NAMESPACES = (
    syscalls.CLONE_NEWNS | syscalls.CLONE_NEWPID | syscalls.CLONE_NEWNET | syscalls.CLONE_NEWIPC | syscalls.CLONE_NEWUTS
)


def run_in_box(main: Callable[[], int], *, lifeline_fd: int | None) -> int:
    """Run ``main`` as PID 1 of a new box and return its exit code.

    Signals that ask this process to end are passed on. When ``lifeline_fd`` (the read end of a pipe whose other end the
    owner holds) reports end of file, the owner is gone: the box gets SIGTERM and, after ``GRACE_S``, SIGKILL.

    Raises:
        MachineError: The kernel refuses a namespace; the text names the way out.
    """
    _unshare()
    pid = os.fork()
    if pid == 0:
        syscalls.set_pdeathsig(signal.SIGKILL)
        code = 70  # EX_SOFTWARE, should main() not even return
        try:
            _private_mounts()
            code = main()
        except BaseException:
            traceback.print_exc()  # into the supervisor's log
        finally:
            os._exit(code)
    return _wait(pid, lifeline_fd)


def _unshare() -> None:
    uid, gid = os.geteuid(), os.getegid()
    flags = _NAMESPACES if uid == 0 else _NAMESPACES | syscalls.CLONE_NEWUSER
    try:
        syscalls.unshare(flags)
    except OSError as error:
        if error.errno == errno.ENOSPC and (uid == 0 or not _user_namespaces_forbidden()):
            raise MachineError(f"the kernel's limit on namespaces is reached ({error}); see /proc/sys/user/") from error
        if uid != 0:
            raise MachineError(explain_userns_denied()) from error
        raise MachineError(f"root may not create namespaces here ({error}); is this a restricted container?") from error
    if uid != 0:
        try:
            Path("/proc/self/setgroups").write_text("deny")
            Path("/proc/self/uid_map").write_text(f"0 {uid} 1")
            Path("/proc/self/gid_map").write_text(f"0 {gid} 1")
        except OSError as error:
            raise MachineError(explain_userns_denied()) from error


def _user_namespaces_forbidden() -> bool:
    """A limit of 0 is a prohibition, though the kernel reports it as a limit that was reached."""
    with contextlib.suppress(OSError):
        return Path("/proc/sys/user/max_user_namespaces").read_text().strip() == "0"
    return False


def _private_mounts() -> None:
    syscalls.mount("none", "/", None, syscalls.MS_REC | syscalls.MS_PRIVATE)
    # A container with a masked /proc refuses this; the lab then works with the /proc that it was given.
    with contextlib.suppress(OSError):
        syscalls.mount("proc", "/proc", "proc", syscalls.MS_NOSUID | syscalls.MS_NODEV | syscalls.MS_NOEXEC)


def _wait(pid: int, lifeline_fd: int | None) -> int:
    pidfd = os.pidfd_open(pid)

    def forward(signum: int, _frame: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signum)
        signal.alarm(STOP_LIMIT_S)  # whoever asked for the end gets it, even from a supervisor that hangs

    for signum in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(signum, forward)
    signal.signal(signal.SIGALRM, lambda _signum, _frame: os.kill(pid, signal.SIGKILL))
    if lifeline_fd is not None and pidfd not in select.select([pidfd, lifeline_fd], [], [])[0]:
        forward(signal.SIGTERM, None)
        if not select.select([pidfd], [], [], GRACE_S)[0]:
            forward(signal.SIGKILL, None)
    _, status = os.waitpid(pid, 0)
    return os.waitstatus_to_exitcode(status)
