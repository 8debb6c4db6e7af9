"""The process between a caller and its box: starts it, and leaves nothing of it behind, however either of them ends.

    caller --(lifeline: the keeper's stdin)--> keeper --> kernel (its own PID namespace where the host allows one)

* The caller ends, even by ``kill -9``: the lifeline reads end of file, the keeper kills the box.
* The keeper is killed: PR_SET_PDEATHSIG kills the kernel's main process; its children go
  with its PID namespace or, where there is none, because they are traced with PTRACE_O_EXITKILL (the built kernel).
* The caller removes the control folder; the keeper does if the caller is gone.

Run as ``python -m netlab.vm.keeper FOLDER namespace|plain ARGV...``; the box's console goes to the keeper's stdout.
"""

from __future__ import annotations

import contextlib
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

from netlab.kernel import syscalls

NAMESPACE, PLAIN = "namespace", "plain"

#: As the shell has it, for a kernel that is no executable.
CANNOT_EXECUTE = 126


def own_pid_namespace(*, as_user: bool) -> bool:
    """Put children to come into a PID namespace that dies with the first of them.

    Args:
        as_user: Whether an ordinary user gets one too. It takes a user namespace, in which all files of others seem to
            belong to nobody; so only a kernel whose processes would outlive it is worth that.

    Returns:
        False where the host forbids it.
    """
    uid, gid = os.geteuid(), os.getegid()
    if uid != 0 and not as_user:
        return False
    flags = syscalls.CLONE_NEWPID if uid == 0 else syscalls.CLONE_NEWPID | syscalls.CLONE_NEWUSER
    try:
        syscalls.unshare(flags)
        if uid != 0:
            for name, text in (("setgroups", "deny"), ("uid_map", f"{uid} {uid} 1"), ("gid_map", f"{gid} {gid} 1")):
                Path("/proc/self", name).write_text(text)
    except OSError:
        return False
    return True


def descendants(root: int) -> list[int]:
    """Process ids below ``root``, children before grandchildren."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError, ValueError, IndexError):
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                children.setdefault(parent, []).append(int(entry.name))
    found, queue = [], [root]
    while queue:
        below = children.get(queue.pop(), [])
        found += below
        queue += below
    return found


def destroy(pid: int) -> None:
    """Kill the box: stop it from the top, then kill from the bottom.

    A guest process that loses its tracer would run on, on the host, with the guest's registers; so it dies first.
    """
    doomed = [pid, *descendants(pid)]
    for number, targets in ((signal.SIGSTOP, doomed), (signal.SIGKILL, doomed[::-1])):
        for target in targets:
            with contextlib.suppress(ProcessLookupError):
                os.kill(target, number)


def reap_orphans() -> None:
    """Kill and collect whatever of the box was handed to this process."""
    while True:
        for below in descendants(os.getpid()):
            with contextlib.suppress(ProcessLookupError):
                os.kill(below, signal.SIGKILL)
        try:
            os.waitpid(-1, 0)
        except ChildProcessError:
            return


def nurse(folder: Path, argv: list[str]) -> NoReturn:
    """The first process of the PID namespace: start the kernel, end as it ends.

    The kernel itself cannot be the first: a panic ends it by SIGABRT, which the first process ignores.
    """
    syscalls.set_pdeathsig(signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    env = {"PATH": "/usr/bin:/bin", "HOME": str(folder), "TMPDIR": str(folder.parent)}
    try:
        box = subprocess.Popen(
            argv, stdin=subprocess.DEVNULL, stderr=subprocess.STDOUT, cwd=folder, env=env, preexec_fn=_before_exec
        )
    except OSError as error:
        print(f"{argv[0]}: {error.strerror}", flush=True)
        os._exit(CANNOT_EXECUTE)
    code = box.wait()
    os._exit(code if code >= 0 else 128 - code)


def _before_exec() -> None:
    syscalls.set_pdeathsig(signal.SIGKILL)


def keep(folder: Path, argv: list[str], *, namespace: bool) -> int:
    """Run the box until it ends or the lifeline does; returns its exit code."""
    syscalls.set_child_subreaper()
    own_pid_namespace(as_user=namespace)
    pid = os.fork()
    if pid == 0:
        nurse(folder, argv)
    ended = os.pidfd_open(pid)
    poll = select.poll()
    poll.register(ended, select.POLLIN)
    poll.register(0, select.POLLIN)
    if any(fd == 0 for fd, _events in poll.poll()):
        destroy(pid)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    reap_orphans()
    return code if code >= 0 else 128 - code


def main() -> None:
    """Signals that a terminal sends to the whole group are the caller's to judge; the lifeline tells."""
    caller = os.getppid()
    os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    folder = Path(sys.argv[1])
    try:
        sys.exit(keep(folder, sys.argv[3:], namespace=sys.argv[2] == NAMESPACE))
    finally:
        if os.getppid() != caller:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
