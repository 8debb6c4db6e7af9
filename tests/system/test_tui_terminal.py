"""The interactive lab as a person sees it: a real pseudo-terminal, a real lab, keys and a mouse."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind
from netlab.scenario import load_scenario
from tests.system.terminal_rig import Terminal

SCENARIO = """# Two robots in a tunnel: a small team to try things on.
name: small
duration: 300s
engine: air
terrain: {tunnels: [{name: adit, path: [[0, 0], [100, 0]], width: 6m}]}
radio: {rate: 20mbit, delay: 2ms, propagation: {model: none}}
nodes:
  base:   {position: [5, 0], processes: [udp_mesh]}
  robot1: {position: [60, 0], processes: [udp_mesh]}
  relay1: {carried_by: robot1, processes: [udp_mesh]}
traffic:
  - {from: robot1, to: base, topic: telemetry, priority: 1, size: 100B, rate: 10Hz}
events:
  - {at: 250s, outage: {between: [base, robot1], for: 10s}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "topologies").mkdir()
    (tmp_path / "topologies" / "small.yaml").write_text(SCENARIO)
    return tmp_path


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    """With labs of its own; others on this machine are not in sight."""
    kept = {key: value for key, value in os.environ.items() if key not in ("SSH_CONNECTION", "NO_COLOR")}
    with tempfile.TemporaryDirectory(prefix="nl-") as runtime:
        yield {**kept, "NETLAB_RUNTIME_DIR": runtime, "SHELL": "/bin/sh"}


@pytest.fixture
def terminal(folder: Path, environment: dict[str, str]) -> Iterator[Terminal]:
    terminal = Terminal([sys.executable, "-m", "netlab", "lab"], cwd=folder, env=environment)
    yield terminal
    terminal.close()


def begin(terminal: Terminal) -> None:
    """Choose the only topology, and wait for its first messages."""
    screen = terminal.until("Choose a topology")
    assert "small" in screen
    assert "Two robots in a tunnel" in screen
    terminal.press("enter")
    terminal.until("▶ running")
    terminal.until(lambda screen: "priority 1 " in screen and "robot1" in screen)


def test_the_tour_from_the_first_key_to_the_last(terminal: Terminal, folder: Path) -> None:
    begin(terminal)
    terminal.until("adit")  # the map with its tunnel and who is in it
    terminal.find("base", left_of=70)
    terminal.find("● robot1", left_of=70)
    terminal.press("?")
    assert "1/12  Welcome" in terminal.until("1/12")
    terminal.press("enter")
    terminal.until("2/12  A node")
    terminal.press("right")
    terminal.until("3/12  A link")
    assert "peers" in terminal.until("peers 1 online")
    assert "● udp_mesh ready" in terminal.text
    terminal.press("down")
    terminal.until("4/12  Cut it")
    assert "base — robot1  ━ good" in terminal.until("base — robot1")
    terminal.press("c")
    terminal.until("5/12  What it does")
    assert "Cut base-robot1" in terminal.text
    terminal.until("✕ down")
    assert "✎ outage base-robot1 begins" in terminal.until("✎ outage base-robot1 begins")
    terminal.press("enter")
    terminal.until("6/12  Take it back")
    terminal.press("u")
    terminal.until("7/12  Degrade")
    assert "base — robot1  ━ good" in terminal.until("base — robot1  ━ good")
    terminal.press("d")
    terminal.until("Degrade base-robot1")
    terminal.settle()
    for key in ("enter", "40ms", "enter", "enter"):  # the loss that is proposed, a delay, no rate
        terminal.press(key)
        terminal.settle()
    terminal.until("8/12  Hold")
    assert "┅ poor" in terminal.until("base — robot1  ┅ poor")
    terminal.press(" ")
    terminal.until("9/12  Go on")
    assert "‖ timeline held" in terminal.until("‖ timeline held")
    terminal.press(" ")
    terminal.until("10/12  Mark")
    terminal.until("▶ running")
    terminal.press("b")
    terminal.until("Mark this moment")
    terminal.settle()
    terminal.press("here")
    terminal.settle()
    terminal.press("enter")
    terminal.until("11/12  Save")
    terminal.press("w")
    terminal.until("Save all that was done")
    terminal.settle()
    terminal.press("enter")
    terminal.until("12/12  That is all")
    assert "Saved: netlab run captures/small-replay.yaml" in terminal.text
    terminal.press("enter")
    terminal.until(lambda screen: "12/12" not in screen)
    terminal.press("q")
    assert terminal.end() == 0
    assert b"capture: " in terminal.raw[-2000:]
    kinds = load_scenario(folder / "captures" / "small-replay.yaml").events
    assert sum(event.outage is not None for event in kinds) == 2
    assert any(event.link is not None and event.link.delay_s == 0.04 for event in kinds)
    assert any(event.mark is not None and "here" in event.mark for event in kinds)
    with Capture.open(folder / "captures" / "small.mcap") as capture:
        rows = [r for r in capture.records({Kind.TIMELINE}) if isinstance(r, JsonRecord) and "act" in r.payload]
        acts = [row.payload["act"]["do"] for row in rows]  # type: ignore[index]
    assert acts == ["outage", "outage", "link", "hold", "resume", "mark"]


def test_a_mouse_picks_and_acts(terminal: Terminal) -> None:
    begin(terminal)
    column, row = terminal.find("base", left_of=70)  # on the map
    terminal.click(column - 2, row)
    terminal.until(lambda screen: " base  5.0, 0.0 m" in screen)
    column, row = terminal.find("x kill")
    terminal.click(column + 3, row)
    terminal.until("Killed udp_mesh on base")
    terminal.until("● udp_mesh exited -9")
    column, row = terminal.find("r restart")
    terminal.click(column + 3, row)
    terminal.until("● udp_mesh ready")


def test_a_robot_is_moved_a_relay_placed_and_a_shell_opened(terminal: Terminal) -> None:
    begin(terminal)
    terminal.press("right", "right")
    terminal.until("robot1  60.0, 0.0 m")
    terminal.press("m")
    terminal.until("Move robot1")
    terminal.press("right", "right", "right", "enter")
    terminal.until("robot1 moved to")
    terminal.until(lambda screen: "robot1  60.0, 0.0 m" not in screen)
    terminal.press("p")
    terminal.until("relay1 lies on the ground now")
    terminal.until(lambda screen: any("relay1" in line[:70] for line in screen.splitlines()))  # on the map
    terminal.press("s")
    terminal.until("A shell in robot1")
    terminal.until(lambda _screen: terminal.raw.endswith((b"# ", b"$ ")))  # the shell's prompt
    terminal.press("hostname; exit 0\r")
    terminal.until(lambda _screen: b"\nrobot1\r\n" in terminal.raw)
    terminal.until(lambda _screen: terminal.raw.count(b"\x1b[?1049h") == 2)  # the application is back


def test_without_a_terminal_there_are_lines_and_a_verdict(folder: Path, environment: dict[str, str]) -> None:
    argv = [sys.executable, "-m", "netlab", "lab", "topologies/small.yaml", "--set", "duration=1s"]
    run = subprocess.run(argv, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 0, run.stderr
    assert "t=" in run.stderr
    assert "\x1b" not in run.stderr + run.stdout
    assert "capture: " in run.stdout
    assert (folder / "captures" / "small.mcap").exists()
