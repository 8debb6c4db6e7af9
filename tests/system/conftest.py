"""What all system tests share."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from netlab.kernel import tun
from netlab.kernel.probe import in_child, try_tun
from tests.system.kernel_rig import tc_features

INSTALL = "sudo apt-get install tcpdump tshark iproute2 iputils-ping"


@pytest.fixture
def need_tool() -> Callable[[str], str]:
    """Path of a Debian tool that a test compares with; where it is missing the test is skipped, loudly."""

    def need(name: str) -> str:
        found = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
        if found is None:
            pytest.skip(f"{name} is not installed; this test compares with it. To run it: {INSTALL}")
        return found

    return need


@pytest.fixture
def netem_kernel() -> None:
    """Skip where the kernel lacks sch_netem."""
    problem = tc_features().netem_problem
    if problem is not None:
        pytest.skip(f"{problem}; the tests of its physics run on a kernel that has it (`make test-vm`)")


@pytest.fixture
def taps() -> None:
    """Skip where this user may not make the interfaces of `mesh: flood`."""
    problem = in_child(try_tun)
    if problem is not None:
        pytest.skip(f"no TAP interface ({problem}); {tun.REMEDY}, or run these tests as root")


@pytest.fixture
def no_netem_kernel() -> None:
    """Skip where the kernel has sch_netem."""
    if tc_features().netem_problem is None:
        pytest.skip("this kernel has sch_netem")


class Netlab:
    """The `netlab` command as a user calls it, with labs of its own: others on this machine are not in sight."""

    def __init__(self, runtime: Path, work: Path) -> None:
        self.runtime = runtime
        self.work = work
        self.env = {**os.environ, "NETLAB_RUNTIME_DIR": str(runtime), "NETLAB_TEST_MARK": runtime.name}
        self.env["TMPDIR"] = str(work)
        self.env["PS1"] = "# "  # whatever the shell that runs the tests exports

    def __call__(
        self, *arguments: object, stdin: str = "", cwd: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Run it to its end."""
        return subprocess.run(
            self.argv(*arguments),
            input=stdin,
            cwd=cwd or self.work,
            env=self.env,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    def start(self, *arguments: object) -> subprocess.Popen[str]:
        """Start it, its output in pipes."""
        return subprocess.Popen(
            self.argv(*arguments),
            cwd=self.work,
            env=self.env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    @staticmethod
    def argv(*arguments: object) -> list[str]:
        """The command's argument list."""
        return [sys.executable, "-m", "netlab", *map(str, arguments)]

    def labs(self) -> list[str]:
        """Folders of labs, dead ones included."""
        return sorted(entry.name for entry in self.runtime.iterdir())

    def processes(self) -> dict[int, str]:
        """All processes of these labs and their arguments."""
        mark, found = f"NETLAB_TEST_MARK={self.runtime.name}".encode(), {}
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                with contextlib.suppress(OSError):
                    if mark in (entry / "environ").read_bytes().split(b"\0"):
                        found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        return found

    def process(self, *words: str) -> int:
        """The oldest process whose arguments hold all these words (forked children share their parent's)."""
        found = [pid for pid, text in self.processes().items() if all(word in text for word in words)]
        assert found, words
        return min(found)


@pytest.fixture(scope="session")
def new_netlab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[], Netlab]]:
    """A maker of commands; whatever labs they leave running are taken down at the end."""
    made: list[Netlab] = []

    def new() -> Netlab:
        runtime = Path(tempfile.mkdtemp(prefix="nl-"))  # short: there are sockets in it
        made.append(Netlab(runtime, tmp_path_factory.mktemp("work")))
        return made[-1]

    yield new
    for command in made:
        if command.labs():
            command("down", "--all")
        shutil.rmtree(command.runtime)


@pytest.fixture
def netlab(new_netlab: Callable[[], Netlab]) -> Iterator[Netlab]:
    """The command; after the test no lab of it may be left."""
    command = new_netlab()
    yield command
    left = command.labs()
    if left:
        command("down", "--all")
    assert not left
    assert not list(command.work.glob("netlab-*"))  # temporary captures
