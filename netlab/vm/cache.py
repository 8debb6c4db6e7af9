"""The cache of kernels, shared by all checkouts of one user: names, metadata, locks, atomic entry.

$XDG_CACHE_HOME/netlab/vm/uml/<key>/{linux, config, kernel.json}    built kernels
$XDG_CACHE_HOME/netlab/vm/packages/<package>_<version>/             unpacked Debian packages
$XDG_CACHE_HOME/netlab/vm/work/                                      a build under way, and its log
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path

from netlab.vm import recipe
from netlab.vm.request import BoxError

KERNEL, CONFIG, METADATA = "linux", "config", "kernel.json"


@dataclass(frozen=True, slots=True)
class BuiltKernel:
    """A kernel in the cache.

    Attributes:
        path: The executable.
        key: Its name in the cache.
        source_version: Version of the source package.
        fragment: Hash of the configuration fragment.
        recipe: Version of the recipe.
        sha256: Of the executable.
    """

    path: Path
    key: str
    source_version: str
    fragment: str
    recipe: int
    sha256: str

    @property
    def current(self) -> bool:
        """Whether this is what the checkout at hand would build, from whatever version of the source."""
        return self.fragment == recipe.fragment_hash(fragment()) and self.recipe == recipe.RECIPE_VERSION


def fragment() -> str:
    """The configuration fragment of this checkout."""
    return resources.files("netlab.vm").joinpath("kernel.config").read_text()


def root() -> Path:
    """The cache folder; it need not exist yet."""
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "netlab" / "vm"


def file_hash(path: Path) -> str:
    """SHA-256 of a file, in hex."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_kernel(folder: Path) -> BuiltKernel | None:
    """The kernel in ``folder``; None if there is no whole one."""
    try:
        raw = json.loads((folder / METADATA).read_text())
        kernel = BuiltKernel(path=folder / KERNEL, **raw)
    except (OSError, ValueError, TypeError):
        return None
    return kernel if os.access(kernel.path, os.X_OK) else None


def built_kernels() -> list[BuiltKernel]:
    """All whole kernels in the cache, the newest first."""
    folders = sorted((root() / "uml").glob("*/"), key=lambda folder: folder.stat().st_mtime, reverse=True)
    return [kernel for folder in folders if (kernel := read_kernel(folder)) is not None]


def current_kernel() -> BuiltKernel | None:
    """The newest kernel that fits this checkout; None if none is built."""
    return next((kernel for kernel in built_kernels() if kernel.current), None)


def install(kernel: Path, config: Path, source_version: str) -> BuiltKernel:
    """Put a freshly built kernel into the cache, in one step."""
    text = fragment()
    name = recipe.key(source_version, text)
    with entering(root() / "uml" / name) as folder:
        shutil.copy(kernel, folder / KERNEL)
        (folder / KERNEL).chmod(0o755)
        shutil.copy(config, folder / CONFIG)
        sha256 = file_hash(folder / KERNEL)
        built = BuiltKernel(
            folder / KERNEL, name, source_version, recipe.fragment_hash(text), recipe.RECIPE_VERSION, sha256
        )
        raw = asdict(built)
        del raw["path"]
        (folder / METADATA).write_text(json.dumps(raw, indent=2) + "\n")
    found = read_kernel(root() / "uml" / name)
    assert found is not None
    return found


@contextlib.contextmanager
def entering(target: Path) -> Iterator[Path]:
    """A new folder to fill, which becomes ``target`` in one rename if the body ends well; whoever is later loses."""
    target.parent.mkdir(parents=True, exist_ok=True)
    staged = Path(tempfile.mkdtemp(prefix=".new-", dir=target.parent))
    try:
        yield staged
        staged.chmod(0o755)
        with contextlib.suppress(FileExistsError):
            _replace(staged, target)
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def _replace(staged: Path, target: Path) -> None:
    """A folder cannot be renamed over a full one: move that aside first."""
    if target.exists():
        old = Path(tempfile.mkdtemp(prefix=".old-", dir=target.parent))
        target.rename(old / target.name)
        shutil.rmtree(old, ignore_errors=True)
    staged.rename(target)


@contextlib.contextmanager
def locked(name: str) -> Iterator[None]:
    """Hold the cache's lock ``name``; it goes with the process, however that ends.

    Raises:
        BoxError: Another process holds it.
    """
    folder = root()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stream = (folder / f"{name}.lock").open("a+")
    except OSError as error:
        raise BoxError(f"{folder}: {error.strerror}; the cache of kernels must be writable (XDG_CACHE_HOME)") from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.seek(0)
            holder = stream.read().strip() or "unknown"
            raise BoxError(f"process {holder} is busy with the same ({name}); wait until it has ended") from None
        stream.truncate(0)
        stream.write(str(os.getpid()))
        stream.flush()
        yield
