"""Requests: quantities, the environment, and where the box's memory goes."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.vm import places
from netlab.vm.places import Candidate
from netlab.vm.request import BoxError, BoxRequest, clean_environment, parse_memory

GIB = 1 << 30


@pytest.mark.parametrize(
    ("text", "size_bytes"), [("512M", 512 << 20), ("2G", 2 * GIB), ("1gib", GIB), (" 128MB ", 128 << 20)]
)
def test_memory_is_read_with_its_unit(text: str, size_bytes: int) -> None:
    assert parse_memory(text) == size_bytes


@pytest.mark.parametrize("text", ["", "2", "2T", "-1G", "1.5G", "64M", "G"])
def test_memory_without_unit_or_too_little_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"512M|128M"):
        parse_memory(text)


@given(st.text(max_size=8))
def test_memory_is_an_amount_or_a_value_error(text: str) -> None:
    with contextlib.suppress(ValueError):
        assert parse_memory(text) >= 128 << 20


def test_a_request_is_checked_when_it_is_made() -> None:
    with pytest.raises(ValueError, match="command"):
        BoxRequest((), Path("/"))
    with pytest.raises(ValueError, match="positive"):
        BoxRequest(("true",), Path("/"), timeout_s=0)
    with pytest.raises(ValueError, match="too few"):
        BoxRequest(("true",), Path("/"), memory_bytes=1)


def test_credentials_and_sockets_stay_outside() -> None:
    env = {
        "PATH": "/opt/bin",
        "HOME": "/home/u",
        "LC_ALL": "C",
        "PYTEST_ADDOPTS": "-x",
        "SECRET_TOKEN": "s",
        "SSH_AUTH_SOCK": "/tmp/agent",
        "TMPDIR": "/elsewhere",
    }
    kept = clean_environment(env, extra={"MORE": "1"})
    assert set(kept) == {"PATH", "HOME", "LC_ALL", "PYTEST_ADDOPTS", "MORE"}
    assert kept["PATH"].startswith("/opt/bin:")
    assert kept["PATH"].endswith("/sbin")


def test_memory_goes_to_the_first_folder_with_room_and_says_what_it_passed_over() -> None:
    found = [
        Candidate(Path("/noexec"), 9 * GIB, "mounted noexec"),
        Candidate(Path("/small"), GIB),
        Candidate(Path("/wide"), 9 * GIB),
    ]
    folder, notes = places.choose(found, 2 * GIB)
    assert folder == Path("/wide")
    assert notes == ("the box's memory lies in /wide: /noexec is mounted noexec; /small has 1024 MiB free",)


def test_the_best_folder_needs_no_note() -> None:
    assert places.choose([Candidate(Path("/a"), 9 * GIB)], GIB) == (Path("/a"), ())


def test_full_folders_are_told_before_anything_starts() -> None:
    with pytest.raises(BoxError, match=r"no room .* 2048 MiB .*/dev/shm has 0 MiB free.*--memory"):
        places.choose([Candidate(Path("/dev/shm"), 0)], 2 * GIB)


def test_a_folder_that_cannot_be_written_or_named_is_no_candidate(tmp_path: Path) -> None:
    spaced = tmp_path / "with space"
    spaced.mkdir()
    assert "space" in str(places.examine(spaced).problem)
    assert places.examine(tmp_path / "missing").problem == "No such file or directory"
    assert places.examine(tmp_path).problem is None


def test_what_is_needed_below_fresh_folders_stays_visible() -> None:
    needed = [Path("/tmp/clone/tests"), Path("/tmp/clone"), Path("/home/u"), Path("/dev/shm/x/y"), Path("/tmp")]
    assert places.visible_paths(needed) == ["/dev/shm/x", "/tmp/clone"]


def test_the_output_folder_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(BoxError, match="mkdir -p"):
        places.check_output(tmp_path / "none")
    (tmp_path / "file").touch()
    with pytest.raises(BoxError, match="not a folder"):
        places.check_output(tmp_path / "file")
    (tmp_path / "link").symlink_to(tmp_path)
    assert places.check_output(tmp_path / "link") == tmp_path


def test_folders_that_nobody_holds_are_swept(tmp_path: Path) -> None:
    left, used, other = (tmp_path / name for name in ("netlab-vm-left", "netlab-vm-used", "somebody-else"))
    for folder in (left, used, other):
        folder.mkdir()
    held = places.hold(used)
    young_s = left.stat().st_mtime + places.YOUNG_S / 2
    places.sweep(tmp_path, now_s=young_s)
    assert left.exists()
    places.sweep(tmp_path, now_s=young_s + places.YOUNG_S)
    assert (left.exists(), used.exists(), other.exists()) == (False, True, True)
    os.close(held)
    places.sweep(tmp_path, now_s=young_s + places.YOUNG_S)
    assert not used.exists()
