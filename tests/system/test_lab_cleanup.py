"""However a lab dies, a second later nothing of it is left: no process, namespace, interface or mount."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from netlab.lab.facade import Lab

LIMIT_S = 1.0
SCENARIO = {
    "name": "doomed",
    "duration": "60s",
    "nodes": {
        name: {"processes": ["udp_mesh", {"argv": ["sleep", "3141.5"], "name": "sleeper"}]} for name in ("a", "b", "c")
    },
    "links": [{"between": ["a", "b"], "delay": "5ms"}, {"between": ["b", "c"]}],
    "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "20Hz"}],
}
KINDS = ("net", "mnt", "pid", "ipc", "uts", "user")


class Leftovers:
    """Processes of one lab (by a mark in their environment) and who holds its namespaces.

    A namespace's number is given to the next one as soon as it is free, so a number alone tells nothing while other
    labs come and go: only those processes count that held a namespace of the lab while it lived.
    """

    def __init__(self, mark: str) -> None:
        self._mark = f"NETLAB_TEST_MARK={mark}".encode()
        self._own = {str(Path(f"/proc/self/ns/{kind}").readlink()) for kind in KINDS}
        self.namespaces = {name for pid in self.processes() for name in self._held_by(pid)}
        everybody = [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]
        self._holders = {(pid, _started(pid)) for pid in everybody if self._held_by(pid) & self.namespaces}

    def processes(self) -> list[int]:
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit() and int(entry.name) != os.getpid():
                try:
                    if self._mark in (entry / "environ").read_bytes().split(b"\0"):
                        found.append(int(entry.name))
                except OSError:
                    continue
        return found

    def alive_namespaces(self) -> set[str]:
        """Namespaces of the lab that one of their former holders still is in or holds open."""
        alive = [pid for pid, started in self._holders if _started(pid) == started and not _is_zombie(pid)]
        return {name for pid in alive for name in self._held_by(pid)} & self.namespaces

    def _held_by(self, pid: int) -> set[str]:
        found = set()
        for link in (*Path(f"/proc/{pid}/ns").glob("*"), *_descriptors(pid)):
            try:
                target = str(link.readlink())
            except OSError:
                continue
            if target.partition(":")[0] in KINDS:
                found.add(target)
        return found - self._own


def _started(pid: int) -> str:
    """When a process started, in clock ticks since boot; tells it from a later one of the same number."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
    except OSError:
        return ""


def _is_zombie(pid: int) -> bool:
    try:
        return "\nState:\tZ" in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def _descriptors(pid: int) -> list[Path]:
    try:
        return list(Path(f"/proc/{pid}/fd").iterdir())
    except OSError:
        return []


def _host_state() -> tuple[str, list[str]]:
    return Path("/proc/self/mountinfo").read_text(), sorted(entry.name for entry in Path("/sys/class/net").iterdir())


def _within_limit(gone: Callable[[], bool], what: Callable[[], object]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not gone():
        if time.monotonic() > deadline:
            pytest.fail(f"still there after {LIMIT_S} s: {what()}")


@pytest.fixture
def running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Lab, Leftovers]:
    mark = tmp_path.name + str(os.getpid())
    monkeypatch.setenv("NETLAB_TEST_MARK", mark)
    lab = Lab(SCENARIO, capture=tmp_path / "run.mcap").start()
    lab.begin()
    lab.wait_until(0.5)
    return lab, Leftovers(mark)


def _assert_nothing_left(leftovers: Leftovers, before: tuple[str, list[str]]) -> None:
    _within_limit(
        lambda: not leftovers.processes() and not leftovers.alive_namespaces(),
        lambda: (leftovers.processes(), leftovers.alive_namespaces()),
    )
    assert _host_state() == before


@pytest.mark.parametrize("inner", [False, True], ids=["outer process", "PID 1 of the lab"])
def test_killing_the_supervisor_leaves_nothing(running: tuple[Lab, Leftovers], inner: bool) -> None:
    lab, leftovers = running
    before = _host_state()
    assert len(leftovers.processes()) > 10
    assert len([name for name in leftovers.namespaces if name.startswith("net:")]) == 4  # the lab's own and three nodes
    pid = lab.supervisor_pid
    if inner:
        pid = int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])
    os.kill(pid, signal.SIGKILL)
    _assert_nothing_left(leftovers, before)
    lab.close()


def test_an_orderly_end_leaves_nothing(running: tuple[Lab, Leftovers]) -> None:
    lab, leftovers = running
    before = _host_state()
    lab.close()
    _assert_nothing_left(leftovers, before)


def test_killing_pytest_leaves_nothing(tmp_path: Path) -> None:
    mark = tmp_path.name + str(os.getpid())
    script = tmp_path / "test_inner.py"
    script.write_text(
        "import os\nimport pathlib\n"
        f"SCENARIO = {SCENARIO!r}\n"
        "def test_inner(make_lab):\n"
        "    lab = make_lab(SCENARIO)\n"
        "    lab.begin()\n"
        f"    pathlib.Path({str(tmp_path / 'up')!r}).write_text('up')\n"
        "    lab.finish()\n"
    )
    before = _host_state()
    inner = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(script)],
        cwd=tmp_path,
        env={**os.environ, "NETLAB_TEST_MARK": mark, "PYTEST_ADDOPTS": ""},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    deadline = time.monotonic() + 30
    while not (tmp_path / "up").exists():
        assert inner.poll() is None, inner.communicate()[0].decode()
        assert time.monotonic() < deadline
    leftovers = Leftovers(mark)
    assert leftovers.namespaces
    inner.kill()
    inner.communicate()
    _assert_nothing_left(leftovers, before)
