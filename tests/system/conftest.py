"""What all system tests share."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable

import pytest

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
