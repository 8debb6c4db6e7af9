"""Fixtures of the box's tests."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from netlab.vm import cache
from netlab.vm.fitness import INSIDE, ptrace_problem
from netlab.vm.kernels import Kernel, select
from netlab.vm.request import Clock, KernelChoice

IN_BOX = INSIDE in os.environ  # before a fixture hides it

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(autouse=True)
def outside(monkeypatch: pytest.MonkeyPatch) -> None:
    """These tests look at the box from outside, also where the suite itself runs in one."""
    monkeypatch.delenv(INSIDE, raising=False)


@pytest.fixture
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of the test's own for the box's memory, so that remains can be seen."""
    folder = tmp_path / "memory"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    return folder


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return cache.root()


@pytest.fixture
def built_kernel() -> Kernel:
    """The built kernel; the test is skipped, loudly, where there is none."""
    if IN_BOX:
        pytest.skip("this is the inside of a box; the test looks at one from outside")
    if ptrace_problem():
        pytest.skip("this machine refuses ptrace, which the box needs")
    if cache.current_kernel() is None:
        pytest.skip("the box's kernel is not built; to run this test too: netlab vm build")
    return select(KernelChoice.UML, Clock.VIRTUAL)
