"""Supervisors that are forked instead of executed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from netlab.errors import LabError, MachineError
from netlab.lab.facade import Lab
from netlab.lab.nursery import Nursery

TWO = {"duration": "1s", "nodes": {"a": {}, "b": {}}, "links": [{"between": ["a", "b"]}]}


@pytest.fixture
def nursery() -> Iterator[Nursery]:
    made = Nursery()
    yield made
    made.close()


def test_labs_have_the_folder_and_the_environment_of_their_start(
    nursery: Nursery, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for robot in ("r1", "r2"):
        monkeypatch.setenv("ROBOT", robot)
        (tmp_path / robot).mkdir()
        monkeypatch.chdir(tmp_path / robot)
        with Lab(TWO, nursery=nursery) as lab:
            told = lab.exec("a", "sh", "-c", "echo $ROBOT; pwd; ping -c1 b >/dev/null && echo heard").stdout.split()
            assert told == [robot, str(tmp_path / robot), "heard"]


def test_a_lab_outlives_its_nursery(nursery: Nursery) -> None:
    with Lab(TWO, nursery=nursery) as lab:
        nursery.close()
        assert lab.status()["phase"] == "ready"
        assert lab.exec("a", "ping", "-c1", "b").returncode == 0


def test_what_cannot_start_says_so_as_ever(nursery: Nursery) -> None:
    nowhere = {**TWO, "nodes": {"a": {"processes": [{"argv": ["/no/such/program"]}]}, "b": {}}}
    with pytest.raises((LabError, MachineError), match="/no/such/program"):
        Lab(nowhere, nursery=nursery).start()
    with Lab(TWO, nursery=nursery) as lab:
        assert lab.status()["phase"] == "ready"


def test_a_nursery_that_is_gone_is_named(nursery: Nursery) -> None:
    nursery.close()
    with pytest.raises(LabError, match="the process that starts labs is gone"):
        Lab(TWO, nursery=nursery).start()
