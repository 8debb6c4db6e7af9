"""The interactive lab, shown to Foxglove beside its screen; asked by a client that knows nothing of netlab."""

from __future__ import annotations

import json
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.terminal_rig import Terminal

pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
sync = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")

PAIR = Path(__file__).parents[2] / "topologies" / "pair.yaml"


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    with tempfile.TemporaryDirectory(prefix="nl-") as runtime:
        argv = [sys.executable, "-m", "netlab", "lab", "--foxglove=0", "--set", "duration=300s", str(PAIR)]
        terminal = Terminal(argv, cwd=tmp_path, env={**os.environ, "NETLAB_RUNTIME_DIR": runtime})
        yield terminal
        terminal.close()


def test_the_screen_tells_the_address_and_the_same_channels_are_there(terminal: Terminal) -> None:
    screen = terminal.until(lambda text: re.search(r"ws://127\.0\.0\.1:\d+", text) is not None)
    found = re.search(r"ws://127\.0\.0\.1:\d+", screen)
    assert found is not None
    topics: set[str] = set()
    with sync.connect(found[0], subprotocols=["foxglove.sdk.v1"]) as viewer:
        while not topics >= {"/timeline", "/links", "/base/eth0/packets"}:
            message = viewer.recv(timeout=30)
            if isinstance(message, str) and (told := json.loads(message))["op"] == "advertise":
                topics |= {channel["topic"] for channel in told["channels"]}
    terminal.press("q")
    assert terminal.end() == 0
