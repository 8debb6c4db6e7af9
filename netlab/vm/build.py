"""Builds the box's kernel from Debian's source: checked, logged, resumable, and entered into the cache at once."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from netlab.kernel import syscalls
from netlab.vm import cache, packages, recipe
from netlab.vm.cache import BuiltKernel
from netlab.vm.recipe import Progress
from netlab.vm.request import BoxError

#: The unpacked source with all objects.
SCRATCH_BYTES = 3 << 30
_TAIL_LINES = 15
_SBIN = "/usr/local/sbin:/usr/sbin:/sbin"
_INCLUDE = Path("/usr/include")
_REPORT_EVERY_S = 10.0

#: Takes a phase, seconds since the build began and a guess of how much is done, 0 to 100.
Report = Callable[[str, float, int], None]


def missing_tools(path: str | None = None, include: Path = _INCLUDE) -> list[str]:
    """Debian packages that the build needs and this machine lacks, in one list."""
    search = f"{os.environ.get('PATH', '')}:{_SBIN}" if path is None else path
    lacking = {package for tool, package in recipe.TOOLS.items() if shutil.which(tool, path=search) is None}
    lacking |= {package for header, package in recipe.HEADERS.items() if not (include / header).exists()}
    return sorted(lacking)


def check_tools(lacking: list[str]) -> None:
    """Refuse a build that would stop half way.

    Raises:
        BoxError: Packages are missing; the text has the one command that adds all of them.
    """
    if lacking:
        raise BoxError(
            f"building the kernel needs {', '.join(lacking)}, not installed here. "
            f"To add: sudo apt-get install {' '.join(lacking)}"
        )


def build(report: Report, *, jobs: int, force: bool = False) -> BuiltKernel:
    """The kernel of this checkout, built now unless the cache has it (then at once).

    Args:
        report: Told about the progress.
        jobs: Compilers side by side.
        force: Build even if the cache has it.

    Raises:
        BoxError: Tools or room are missing, another build is under way, or a step failed; the text names the log.
    """
    known = cache.current_kernel()
    if known is not None and not force:
        return known
    check_tools(missing_tools())
    with cache.locked("build"):
        work = cache.root() / "work"
        work.mkdir(parents=True, exist_ok=True)
        check_room(shutil.disk_usage(work).free, work)
        return _Build(work, packages.candidate_version(recipe.SOURCE_PACKAGE), report, jobs).run()


def check_room(free_bytes: int, work: Path) -> None:
    """Refuse where the source tree does not fit.

    Raises:
        BoxError: Too little room.
    """
    if free_bytes < SCRATCH_BYTES:
        raise BoxError(
            f"{work} has {free_bytes >> 20} MiB free; building takes {SCRATCH_BYTES >> 20} MiB for some minutes. "
            "Free some, or set XDG_CACHE_HOME to a folder with room."
        )


class _Build:
    """One build; its folder is kept when a step fails, so that the next try goes on from there."""

    def __init__(self, work: Path, version: str, report: Report, jobs: int) -> None:
        self._folder = work / version.replace(":", "%3a")
        self._tree = self._folder / recipe.SOURCE_TREE
        self._log = work / f"build-{self._folder.name}.log"
        self._version = version
        self._report = report
        self._jobs = jobs
        self._began_s = time.monotonic()

    def run(self) -> BuiltKernel:
        self._log.write_bytes(b"")
        if not (self._folder / "unpacked").exists():
            self._unpack()
        self._patch()
        self._configure()
        self._compile()
        self._say("install", 99)
        stripped = self._folder / "linux.stripped"
        self._step(["strip", "-o", str(stripped), str(self._tree / "linux")])
        built = cache.install(stripped, self._tree / ".config", self._version)
        shutil.rmtree(self._folder, ignore_errors=True)
        return built

    def _unpack(self) -> None:
        self._say("fetch", 0)
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder.mkdir()
        packages.fetch(recipe.SOURCE_PACKAGE, self._folder)
        self._say("unpack", 2)
        self._step(["tar", "-xf", f"usr/src/{recipe.SOURCE_TREE}.tar.xz"], self._folder)
        (self._folder / "unpacked").touch()

    def _patch(self) -> None:
        for patch in recipe.PATCHES:
            path = self._tree / patch.path
            text = path.read_text()
            try:
                changed = recipe.apply_patch(patch, text)
            except ValueError as error:
                raise BoxError(str(error)) from error
            if changed != text:
                path.write_text(changed)

    def _configure(self) -> None:
        self._say("configure", 5)
        fragment = self._folder / "fragment.config"
        fragment.write_text(cache.fragment())
        self._make("defconfig")
        self._step(["scripts/kconfig/merge_config.sh", "-m", ".config", str(fragment)])
        self._make("olddefconfig")
        lost = recipe.lost_options(cache.fragment(), (self._tree / ".config").read_text())
        if lost:
            raise BoxError(f"{recipe.SOURCE_PACKAGE} {self._version} does not take these options: {', '.join(lost)}")

    def _compile(self) -> None:
        progress = Progress()
        said_s = -_REPORT_EVERY_S
        for line in self._lines(["make", "ARCH=um", f"-j{self._jobs}", "linux"]):
            progress.line(line)
            if time.monotonic() - said_s >= _REPORT_EVERY_S:
                said_s = time.monotonic()
                self._say("compile", 6 + progress.percent * 93 // 100)

    def _make(self, target: str) -> None:
        self._step(["make", "ARCH=um", target])

    def _step(self, argv: list[str], cwd: Path | None = None) -> None:
        for _line in self._lines(argv, cwd):
            pass

    def _lines(self, argv: list[str], cwd: Path | None = None) -> Iterator[str]:
        """Run one step at low priority; yields and logs what it prints."""
        env = {"PATH": f"{os.environ.get('PATH', '')}:{_SBIN}", "HOME": str(self._folder), "LC_ALL": "C.UTF-8"}
        with (
            self._log.open("a") as log,
            subprocess.Popen(
                ["nice", "-n", "15", *argv],
                cwd=cwd or self._tree,
                env=env,
                text=True,
                errors="replace",
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                preexec_fn=_end_with_parent,
            ) as process,
        ):
            assert process.stdout is not None
            for line in process.stdout:
                log.write(line)
                yield line
        if process.returncode:
            tail = "\n".join(f"  {line}" for line in self._log.read_text().splitlines()[-_TAIL_LINES:])
            raise BoxError(f"`{' '.join(argv)}` failed; the whole log is {self._log}. Its end:\n{tail}")

    def _say(self, phase: str, percent: int) -> None:
        self._report(phase, time.monotonic() - self._began_s, percent)


def _end_with_parent() -> None:
    syscalls.set_pdeathsig(signal.SIGTERM)
