"""tshark with the dissectors installed as a user installs them, and captures in the making."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from netlab.capture.pcapng import PcapngWriter
from tests.wireshark.tshark_rig import Tape, Tshark, installed_tshark


@pytest.fixture(scope="session")
def tshark(tmp_path_factory: pytest.TempPathFactory) -> Tshark:
    """The tool; where it is missing the tests are skipped, loudly."""
    return installed_tshark(tmp_path_factory.mktemp("home"))


@pytest.fixture
def new_tape(tmp_path: Path) -> Iterator[Callable[[], Tape]]:
    """A maker of captures."""
    files = []

    def new() -> Tape:
        path = tmp_path / f"tape{len(files)}.pcapng"
        files.append(path.open("wb", buffering=0))
        return Tape(path, PcapngWriter(files[-1], application="test"), {})

    yield new
    for file in files:
        file.close()


@pytest.fixture
def tape(new_tape: Callable[[], Tape]) -> Tape:
    """One capture."""
    return new_tape()
