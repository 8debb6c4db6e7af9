"""Which paths stay visible in a node."""

from __future__ import annotations

from pathlib import Path

from netlab.lab.isolation import keep_paths


def test_paths_inside_others_and_missing_ones_are_dropped(tmp_path: Path) -> None:
    inner = tmp_path / "project" / "venv"
    inner.mkdir(parents=True)
    assert keep_paths(inner, tmp_path / "project", tmp_path / "missing", "/") == (str(tmp_path / "project"),)


def test_a_similar_beginning_is_not_inside(tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab2").mkdir()
    assert keep_paths(tmp_path / "lab", tmp_path / "lab2") == (str(tmp_path / "lab"), str(tmp_path / "lab2"))
