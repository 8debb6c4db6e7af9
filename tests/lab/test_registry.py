"""Folders of running labs: locks tell the living from the dead."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from netlab.errors import LabError
from netlab.lab import registry


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "labs"
    path.mkdir(mode=0o700)
    monkeypatch.setattr(registry, "runtime_root", lambda: path)
    return path


def test_a_lab_is_found_while_its_lock_is_held_and_removed_afterwards() -> None:
    folder, fd = registry.create("relay")
    (folder.path / "logs").mkdir()
    assert registry.running() == [folder]
    os.close(fd)
    assert registry.running() == []
    assert not folder.path.exists()


def test_find_takes_the_only_lab_a_name_or_its_beginning() -> None:
    first, first_fd = registry.create("relay")
    assert registry.find(None) == first
    second, second_fd = registry.create("outage")
    assert registry.find("out") == second
    assert registry.find(first.name) == first
    with pytest.raises(LabError, match="more than one lab is running"):
        registry.find(None)
    with pytest.raises(LabError, match="no lab is called 'pair'; running: "):
        registry.find("pair")
    os.close(first_fd)
    os.close(second_fd)


def test_without_any_lab_the_way_to_start_one_is_told() -> None:
    with pytest.raises(LabError, match="netlab up FILE"):
        registry.find(None)


def test_two_labs_of_one_scenario_have_different_names() -> None:
    (a, a_fd), (b, b_fd) = registry.create("same"), registry.create("same")
    assert a.name != b.name
    assert a.name.startswith("same-")
    os.close(a_fd)
    os.close(b_fd)


def test_a_folder_that_others_can_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(os, "getuid", lambda: 4242)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(LabError, match="must belong to you alone"):
        registry.runtime_root()
