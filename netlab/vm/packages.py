"""Debian packages by name, unpacked into the cache and never installed. Needs apt and dpkg, not root."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from netlab.vm import cache
from netlab.vm.request import BoxError


def candidate_version(package: str) -> str:
    """The version that apt would fetch.

    Raises:
        BoxError: No apt here, or it does not know the package.
    """
    if shutil.which("apt-cache") is None:
        raise BoxError(f"{package}: this machine has no apt to fetch it with; use a Debian or Ubuntu machine")
    policy = _run(["apt-cache", "policy", package])
    for line in policy.splitlines():
        label, _colon, value = line.strip().partition(": ")
        if label == "Candidate" and value.strip() != "(none)":
            return value.strip()
    raise BoxError(f"apt does not know the package {package}; try `sudo apt-get update`, or a Debian 12 source list")


def dependency(package: str, prefix: str) -> str:
    """The first dependency of ``package`` whose name starts with ``prefix``.

    Raises:
        BoxError: There is none.
    """
    for line in _run(["apt-cache", "depends", package]).splitlines():
        kind, _colon, name = line.strip().partition(": ")
        if kind == "Depends" and name.startswith(prefix):
            return name
    raise BoxError(f"the package {package} depends on no {prefix}*; try `sudo apt-get update`")


def unpacked(package: str) -> Path:
    """The folder with the unpacked package, fetched now if it is not in the cache.

    Raises:
        BoxError: It cannot be fetched; without a network, what an earlier fetch left is used.
    """
    store = cache.root() / "packages"
    kept = sorted(store.glob(f"{package}_*"), key=lambda folder: folder.stat().st_mtime)
    if kept:
        return kept[-1]
    target = store / f"{package}_{candidate_version(package).replace(':', '%3a')}"
    with cache.locked(f"package-{package}"), cache.entering(target) as folder:
        fetch(package, folder)
    return target


def fetch(package: str, folder: Path) -> None:
    """Download ``package`` and unpack it into ``folder``.

    Raises:
        BoxError: apt or dpkg-deb failed; the text has their last words.
    """
    _run(["apt-get", "download", "-q", package], cwd=folder)
    archive = next(folder.glob("*.deb"), None)
    if archive is None:
        raise BoxError(f"apt-get download {package} left no package behind")
    _run(["dpkg-deb", "-x", str(archive), str(folder)])
    archive.unlink()


def _run(argv: list[str], cwd: Path | None = None) -> str:
    try:
        done = subprocess.run(argv, cwd=cwd, text=True, capture_output=True, stdin=subprocess.DEVNULL, check=False)
    except OSError as error:
        raise BoxError(f"{argv[0]}: {error.strerror}; packages come through apt and dpkg") from error
    if done.returncode:
        words = (done.stderr or done.stdout).strip().splitlines()[-3:]
        raise BoxError(f"`{' '.join(argv)}` failed: {' / '.join(words) or f'exit code {done.returncode}'}")
    return done.stdout
