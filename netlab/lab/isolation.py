"""One node's own view of the machine: hostname, /etc/hosts, private /dev/shm, /tmp and /run, its own /sys.

Without it transports that know shared memory (Zenoh, DDS) would pass messages between "robots" through /dev/shm and
never touch the network. Directories that the node's processes need (the virtual environment, the project, the lab's own
folder) are bound back in when they lie below a directory that gets covered.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

from netlab.kernel import syscalls

COVERED = {"/dev/shm": "mode=1777", "/tmp": "mode=1777", "/run": "mode=755"}


def enter_new_node(hostname: str, hosts: str, keep: Sequence[str]) -> None:
    """Give the calling process new mount, IPC and UTS namespaces, furnished for one node.

    Args:
        hostname: The node's name.
        hosts: Text of the node's /etc/hosts.
        keep: Absolute paths of directories that must stay visible.

    Raises:
        OSError: The kernel refuses a namespace or a tmpfs.
    """
    syscalls.unshare(syscalls.CLONE_NEWNS | syscalls.CLONE_NEWIPC | syscalls.CLONE_NEWUTS)
    syscalls.mount("none", "/", None, syscalls.MS_REC | syscalls.MS_PRIVATE)
    syscalls.sethostname(hostname)
    for directory, options in COVERED.items():
        if Path(directory).is_dir():
            _cover(directory, options, [path for path in keep if _below(path, directory)])
    # /sys shows the interfaces of the namespace that mounted it; restricted containers refuse, and few programs mind.
    with contextlib.suppress(OSError):
        syscalls.mount("sysfs", "/sys", "sysfs", syscalls.MS_NOSUID | syscalls.MS_NODEV | syscalls.MS_NOEXEC)
    _replace_hosts(hosts)


def keep_paths(*paths: str | Path) -> tuple[str, ...]:
    """Resolve, drop those that do not exist and those inside another one of the list."""
    resolved = sorted({str(Path(path).resolve()) for path in paths if Path(path).is_dir()} - {"/"})
    return tuple(path for path in resolved if not any(_below(path, other) for other in resolved if other != path))


def _below(path: str, directory: str) -> bool:
    return path == directory or path.startswith(directory.rstrip("/") + "/")


def _cover(directory: str, options: str, keep: Sequence[str]) -> None:
    kept = [(path, os.open(path, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)) for path in keep if path != directory]
    syscalls.mount("tmpfs", directory, "tmpfs", syscalls.MS_NOSUID | syscalls.MS_NODEV, options)
    for path, fd in kept:
        Path(path).mkdir(parents=True, exist_ok=True)
        syscalls.mount(f"/proc/self/fd/{fd}", path, None, syscalls.MS_BIND | syscalls.MS_REC)
        os.close(fd)


def _replace_hosts(hosts: str) -> None:
    target = Path("/etc/hosts")
    if not target.exists():
        return
    source = Path("/run/hosts")
    source.write_text(hosts)
    syscalls.mount(str(source), str(target), None, syscalls.MS_BIND)
