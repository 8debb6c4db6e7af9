"""Nodes that move, are dropped and are put elsewhere, in a lab and in its capture."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind
from netlab.lab.facade import Lab
from netlab.pytest_plugin import MakeLab

SCENARIO = """
duration: 3s
terrain:
  tunnels:
    - {name: adit,  path: [[0, 0], [120, 0]], width: 4m}
    - {name: drift, path: [[120, 0], [120, 80]], width: 3m}
radio: {propagation: {model: none}}
nodes:
  base: {position: [0, 0], processes: [udp_mesh]}
  robot: {waypoints: [[110, 0], [120, 20]], speed: 10m/s, processes: [udp_mesh]}
  beacon: {carried_by: robot, processes: [udp_mesh]}
traffic:
  - {from: beacon, to: base, topic: alive, size: 100B, rate: 20Hz}
events:
  - {at: 1s, deploy: beacon}
  - {at: 2s, move: {node: base, to: [50, 0]}}
"""


@pytest.fixture
def lab(make_lab: MakeLab) -> Lab:
    return make_lab(yaml.safe_load(SCENARIO))


def records(capture: Path, kind: Kind) -> list[JsonRecord]:
    with Capture.open(capture) as opened:
        return [record for record in opened.records({kind}) if isinstance(record, JsonRecord)]


def scenario_s(record: JsonRecord, t0_ns: int) -> float:
    """When the poses are; those from before t = 0 are those at 0."""
    return round(max((record.number("stamp_ns") - t0_ns) / 1e9, 0.0), 3)


def test_a_robot_moves_drops_a_beacon_and_the_capture_shows_it(lab: Lab) -> None:
    result = lab.run()
    assert not result.problems
    [tunnels] = records(lab.capture, Kind.MAP)
    assert [tunnel["name"] for tunnel in tunnels.payload["tunnels"]] == ["adit", "drift"]  # type: ignore[attr-defined]
    with Capture.open(lab.capture) as capture:
        t0_ns = capture.t0_ns
    places = {
        scenario_s(record, t0_ns): dict(zip(record.payload["nodes"], record.payload["poses"], strict=True))  # type: ignore[call-overload]
        for record in records(lab.capture, Kind.POSES)
    }
    assert places[0.0]["robot"]["position"] == {"x": 110, "y": 0, "z": 0}
    assert places[2.5]["robot"]["position"] == pytest.approx({"x": 120, "y": 15, "z": 0})
    assert places[2.5]["beacon"]["position"] == pytest.approx({"x": 120, "y": 0, "z": 0})
    assert places[1.9]["base"]["position"]["x"] == 0
    assert places[2.5]["base"]["position"]["x"] == 50
    [stream] = result.summary["streams"]
    assert 30 <= stream["sent"] <= 41  # from the moment that it was dropped
    assert stream["delivered"] >= 25


def test_a_carried_node_runs_nothing_and_nobody_hears_it(lab: Lab) -> None:
    running = {row["node"] for row in lab.status()["processes"]}
    assert running == {"base", "robot"}
    assert lab.exec("base", "ping", "-c1", "-W1", "beacon").returncode != 0
    assert lab.exec("base", "ping", "-c1", "-W2", "robot").returncode == 0


def move(lab: Lab, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "netlab", "move", "--lab", lab.name, *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)


def test_a_person_moves_a_node(lab: Lab) -> None:
    lab.move("robot", 30, 0)
    assert move(lab, "robot", "60", "-1").returncode == 0
    refused = move(lab, "robot", "60", "-10")
    assert refused.returncode == 2
    assert refused.stderr.startswith("robot: [60, -10] lies in the rock; the nearest tunnel is 'adit'")
    assert "'beacon' is still carried; move who carries it" in move(lab, "beacon", "60", "0").stderr
    lab.run()
    last = records(lab.capture, Kind.POSES)[-1].payload
    assert last["poses"][1]["position"] == {"x": 60, "y": -1, "z": 0}  # type: ignore[index]
