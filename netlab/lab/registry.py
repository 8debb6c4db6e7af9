"""Where running labs are found: one private folder per lab below the user's runtime directory.

A folder holds the control socket, the logs and generated configuration. Its supervisor holds a lock on it for as long
as it lives; a folder without a held lock belongs to a lab that is gone and is removed by whoever looks next.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import secrets
import shutil
from dataclasses import dataclass
from pathlib import Path

from netlab.errors import LabError

_LONGEST_ROOT = 50  # bytes: the name of a lab's control socket must fit into the 107 of a Unix socket's address


@dataclass(frozen=True, slots=True)
class LabFolder:
    """Paths of one lab. Its name is the scenario's name plus a short unique suffix."""

    path: Path

    @property
    def name(self) -> str:
        """The lab's name, as `netlab ls` shows it."""
        return self.path.name

    @property
    def control_socket(self) -> Path:
        """Where the supervisor listens."""
        return self.path / "control"

    @property
    def logs(self) -> Path:
        """``logs/<node>/<process>.log``"""
        return self.path / "logs"

    @property
    def journal(self) -> Path:
        """The rows of the lab's timeline so far, JSON lines."""
        return self.path / "timeline.jsonl"

    @property
    def lock(self) -> Path:
        """Locked by the supervisor for its whole life."""
        return self.path / "lock"


def runtime_root() -> Path:
    """The user's folder of labs, created for its owner only; ``NETLAB_RUNTIME_DIR`` chooses another one.

    Raises:
        LabError: Somebody else owns that path, it cannot be made or is too long.
    """
    uid = os.getuid()
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if chosen := os.environ.get("NETLAB_RUNTIME_DIR"):
        root = Path(chosen).resolve()
    elif uid == 0 and os.access("/run", os.W_OK):  # the root of a user namespace may not write there
        root = Path("/run/netlab")
    elif runtime and Path(runtime).is_dir() and os.access(runtime, os.W_OK):
        root = Path(runtime) / "netlab"
    else:
        root = Path("/tmp") / f"netlab-{uid}"
    try:
        root.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise LabError(f"{root} cannot be made: {error.strerror}; running labs are kept there") from None
    status = root.lstat()
    if status.st_uid != uid or status.st_mode & 0o077:
        raise LabError(f"{root} must belong to you alone (mode 700); remove it or set NETLAB_RUNTIME_DIR")
    if len(os.fsencode(root)) > _LONGEST_ROOT:
        raise LabError(f"{root} is too long a path for a socket in it; set NETLAB_RUNTIME_DIR to a shorter one")
    return root


def create(scenario_name: str) -> tuple[LabFolder, int]:
    """Make a folder for a new lab; returns it with the locked descriptor that its supervisor must inherit."""
    root = runtime_root()
    while True:
        folder = LabFolder(root / f"{scenario_name[:40]}-{secrets.token_hex(2)}")
        with contextlib.suppress(FileExistsError):
            # Created under another name, locked, then renamed: nobody can take it for abandoned in between.
            hidden = LabFolder(root / f".{folder.name}.{os.getpid()}")
            hidden.path.mkdir(mode=0o700)
            fd = os.open(hidden.lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            fcntl.flock(fd, fcntl.LOCK_EX)
            if not folder.path.exists():
                hidden.path.rename(folder.path)
                return folder, fd
            os.close(fd)
            shutil.rmtree(hidden.path, ignore_errors=True)


def running() -> list[LabFolder]:
    """Folders of labs that are alive; those of dead labs are removed on the way."""
    alive = []
    for path in sorted(runtime_root().iterdir()):
        folder = LabFolder(path)
        if path.name.startswith(".") or not path.is_dir():
            continue
        if _abandoned(folder):
            shutil.rmtree(path, ignore_errors=True)
        else:
            alive.append(folder)
    return alive


def find(name: str | None) -> LabFolder:
    """The lab called ``name`` (its start is enough if that is unique), or the only one running.

    Raises:
        LabError: There is none, or more than one fits; lists them.
    """
    labs = running()
    exact = [lab for lab in labs if lab.name == name]
    fitting = exact or [lab for lab in labs if name is None or lab.name.startswith(name)]
    if len(fitting) == 1:
        return fitting[0]
    if not labs:
        raise LabError("no lab is running; start one with: netlab up FILE")
    names = ", ".join(lab.name for lab in (fitting or labs))
    if not fitting:
        raise LabError(f"no lab is called '{name}'; running: {names}")
    raise LabError(f"more than one lab is running; choose one with --lab: {names}")


def _abandoned(folder: LabFolder) -> bool:
    try:
        fd = os.open(folder.lock, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return True
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(fd)
    return True
