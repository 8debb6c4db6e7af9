"""Where a box keeps its memory and its control folder on the host, and what it must be able to see."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from netlab.vm.guest import FRESH
from netlab.vm.request import BoxError

#: Room beside the guest's memory for its output and the kernel's own temporary files.
SPARE_BYTES = 16 << 20

PREFIX = "netlab-vm-"
YOUNG_S = 60.0


@dataclass(frozen=True, slots=True)
class Candidate:
    """A folder that could hold the guest's memory file.

    Attributes:
        path: The folder.
        free_bytes: What an ordinary user may still write.
        problem: Why it cannot serve at all; None if it can.
    """

    path: Path
    free_bytes: int
    problem: str | None = None


def examine(path: Path) -> Candidate:
    """What this folder offers; the kernel maps its memory executable, so ``noexec`` rules a folder out."""
    try:
        stat = os.statvfs(path)
    except OSError as error:
        return Candidate(path, 0, f"{error.strerror}")
    problem = None
    if stat.f_flag & os.ST_NOEXEC:
        problem = "mounted noexec"
    elif stat.f_flag & os.ST_RDONLY or not os.access(path, os.W_OK | os.X_OK):
        problem = "not writable"
    elif " " in str(path):
        problem = "its path has a space, which the kernel's command line cannot hold"
    return Candidate(path, stat.f_bavail * stat.f_frsize, problem)


def candidates() -> list[Candidate]:
    """Folders for the guest's memory, best first: ``$TMPDIR`` because the person chose it, then memory, then disk."""
    named = os.environ.get("TMPDIR")
    paths = [Path(named)] if named else []
    return [examine(path) for path in dict.fromkeys([*paths, Path("/dev/shm"), Path("/tmp")])]


def choose(found: list[Candidate], memory_bytes: int) -> tuple[Path, tuple[str, ...]]:
    """The first folder with room for the whole memory.

    Checked beforehand because a guest whose memory file cannot grow dies by SIGBUS in the middle of its work.

    Returns:
        The folder, and a note for the person for each better folder that was passed over.

    Raises:
        BoxError: None has room; the text says what each one has.
    """
    passed: list[str] = []
    for candidate in found:
        if candidate.problem is not None:
            passed.append(f"{candidate.path} is {candidate.problem}")
        elif candidate.free_bytes < memory_bytes + SPARE_BYTES:
            passed.append(f"{candidate.path} has {candidate.free_bytes >> 20} MiB free")
        else:
            notes = (f"the box's memory lies in {candidate.path}: {'; '.join(passed)}",) if passed else ()
            return candidate.path, notes
    raise BoxError(
        f"no room for the box's {memory_bytes >> 20} MiB of memory: {'; '.join(passed)}. "
        "Free some, ask for less with --memory, or point TMPDIR at a folder with room."
    )


def make_control_folder(memory: Path) -> Path:
    """A new private folder beside the memory file, in memory where that is."""
    return Path(tempfile.mkdtemp(prefix=PREFIX, dir=memory))


def hold(folder: Path) -> int:
    """Mark a control folder as in use; the mark goes with the last process that has the descriptor."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    fcntl.flock(fd, fcntl.LOCK_EX)
    return fd


def sweep(memory: Path, *, now_s: float) -> None:
    """Remove this user's control folders that nobody holds any more: caller and keeper were both killed.

    Args:
        memory: Where to look.
        now_s: Wall-clock time; a folder younger than ``YOUNG_S`` may not be held yet.
    """
    for folder in memory.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            stat = folder.stat(follow_symlinks=False)
            if stat.st_uid == os.geteuid() and now_s - stat.st_mtime > YOUNG_S and not _held(folder):
                shutil.rmtree(folder, ignore_errors=True)


def _held(folder: Path) -> bool:
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(fd)
    return False


def check_output(output: Path | None) -> Path | None:
    """The output folder with all links resolved, since the guest mounts it by its real path.

    Raises:
        BoxError: It is missing, no folder, or not writable.
    """
    if output is None:
        return None
    if not output.is_dir():
        what = "is not a folder" if output.exists() else "does not exist"
        raise BoxError(f"{output}: the output folder {what}; create it first (mkdir -p {output})")
    if not os.access(output, os.W_OK | os.X_OK):
        raise BoxError(f"{output}: the output folder is not writable for you")
    return output.resolve()


def visible_paths(needed: list[Path]) -> list[str]:
    """What has to stay visible below the folders that are fresh in the box: the first component below each.

    Args:
        needed: Absolute paths that the command uses: its folder, its interpreter, its modules.
    """
    found = []
    for path in needed:
        for fresh in FRESH:
            if path.is_relative_to(fresh) and path != Path(fresh):
                found.append(str(Path(fresh, path.relative_to(fresh).parts[0])))
    return sorted(set(found))
