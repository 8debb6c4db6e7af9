"""Terrain and motion as a file's words: what they mean, and what a person is told about mistakes in them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from netlab.engines.plan import compile_plan
from netlab.errors import ScenarioError
from netlab.scenario import parse_scenario
from netlab.scenario.motion import earlier, later, tracks
from netlab.timeline import compile_timeline

TERRAIN = """\
duration: 120s
terrain:
  tunnels:
    - {name: adit,  path: [[0, 0], [120, 0]], width: 4m}
    - {name: drift, path: [[120, 0], [120, 80]], width: 3m, height: 2m}
"""


def track_of(text: str, node: str, **options: Any) -> Any:
    scenario = parse_scenario(text, name="s.yaml", **options)
    return dict(zip(scenario.nodes, tracks(scenario), strict=True))[node]


def problems(text: str, **options: Any) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, name="s.yaml", **options)
    return caught.value.problems


def test_a_robot_goes_from_waypoint_to_waypoint_along_the_tunnels() -> None:
    track = track_of(
        TERRAIN + "nodes: {r: {waypoints: [[100, 0, {pause: 5s}], [120, 20, {speed: 2m/s}], [120, 50]], speed: 1m/s}}",
        "r",
    )
    assert track.at(5).position_m == (100, 0, 0)
    assert track.at(15).position_m == pytest.approx((120, 0, 0))
    assert track.at(25).position_m == pytest.approx((120, 20, 0))
    assert track.at(35).position_m == pytest.approx((120, 30, 0))


def test_a_position_is_where_a_walk_begins() -> None:
    track = track_of("duration: 9s\nnodes: {r: {position: [9, 9], waypoints: [[0, 9]], speed: 3m/s}}", "r")
    assert track.at(0).position_m == (9, 9, 0)
    assert track.at(3).position_m == pytest.approx((0, 9, 0))


def test_followers_beacons_and_moves() -> None:
    text = """
duration: 100s
nodes:
  tail: {follow: head, distance: 10m}
  beacon: {carried_by: tail}
  head: {waypoints: [[0, 0], [50, 0]], speed: 1m/s}
  still: {position: [0, 5], heading: 45deg}
events:
  - {at: 30s, deploy: beacon}
  - {at: 60s, move: {node: still, to: [0, 15], speed: 1m/s}}
"""
    assert track_of(text, "tail").at(40).position_m == pytest.approx((30, 0, 0))
    assert track_of(text, "beacon").at(90).position_m == pytest.approx((20, 0, 0))
    assert track_of(text, "beacon").active_from_s == 30
    assert track_of(text, "still").at(50).heading_deg == 45
    assert track_of(text, "still").at(65).position_m == pytest.approx((0, 10, 0))


def test_generated_nodes_may_walk() -> None:
    text = "duration: 9s\ngenerate: {shape: line, count: 2, node: {waypoints: [[0, 0], [9, 0]], speed: 1m/s}}"
    assert track_of(text, "n2").at(0).position_m == (0, 0, 0)


def test_motion_of_other_programs(tmp_path: Path) -> None:
    (tmp_path / "walk.movements").write_text("0.0 1.0 1.0 10.0 11.0 1.0\n0.0 5.0 5.0\n")
    text = "duration: 9s\nmotion: {file: walk.movements, nodes: [b, a]}\nnodes: {a: , b: , c: {position: [7, 7]}}"
    assert track_of(text, "b", directory=tmp_path).at(5).position_m == (6, 1, 0)
    assert track_of(text, "a", directory=tmp_path).at(5).position_m == (5, 5, 0)
    assert track_of(text, "c", directory=tmp_path).at(5).position_m == (7, 7, 0)


@pytest.mark.parametrize(
    ("motion", "text"),
    [
        ("{file: m.csv}", "at_s,x,y\n0,1,1\n10,11,1\n"),
        ("{file: m.csv, node: husky}", "at_s,node,x,y\n0,husky,1,1\n0,spot,9,9\n10,husky,11,1\n"),
        ("{file: m.movements, node: 1}", "0 9 9\n0 1 1 10 11 1\n"),
        ("{file: m.tcl}", '$node_(0) set X_ 1\n$node_(0) set Y_ 1\n$ns_ at 0 "$node_(0) setdest 11 1 1"\n'),
    ],
)
def test_a_node_has_a_motion_file_of_its_own_beside_a_common_one(tmp_path: Path, motion: str, text: str) -> None:
    (tmp_path / motion.removeprefix("{file: ").rstrip("}").partition(",")[0]).write_text(text)
    (tmp_path / "all.csv").write_text("at_s,node,x,y\n0,b,7,7\n")
    source = f"duration: 9s\nmotion: {{file: all.csv}}\nnodes: {{a: {{motion: {motion}}}, b: }}"
    assert track_of(source, "a", directory=tmp_path).at(5).position_m == (6, 1, 0)
    assert track_of(source, "b", directory=tmp_path).at(5).position_m == (7, 7, 0)


@pytest.mark.parametrize(
    ("node", "text", "expected"),
    [
        ("motion: {file: m.csv}", "at_s,x,y\n1,0,0\n0,1,1\n", "nodes.r.motion: m.csv:3: 0 s is before the row above;"),
        ("motion: {file: m.csv}", "at_s,x\n1,0\n", "nodes.r.motion: m.csv:1: the columns must be at_s,node,x,y or"),
        (
            "motion: {file: m.csv}",
            "at_s,node,x,y\n0,p,0,0\n0,q,0,0\n",
            "nodes.r.motion: 'm.csv' has 2 nodes; add node: with one of p, q",
        ),
        ("motion: {file: m.csv, node: 3}", "at_s,x,y\n", "nodes.r.motion: 'm.csv' says nothing of any node"),
        (
            "motion: {file: m.csv, node: z}",
            "at_s,node,x,y\n0,p,0,0\n",
            "nodes.r.motion: 'm.csv' has no node 'z'; it has p",
        ),
        (
            "motion: {file: m.csv}, position: [0, 0]",
            "at_s,x,y\n0,0,0\n",
            "nodes.r: position means nothing beside motion; remove one of the two",
        ),
        (
            "motion: {file: m.csv}",
            "at_s,x,y\n0,0,0\n4,60,30\n",
            "nodes.r.motion.file: m.csv: at 4 s: [60, 30] lies in the rock; the nearest tunnel is 'adit'",
        ),
    ],
)
def test_wrong_motion_of_one_node(tmp_path: Path, node: str, text: str, expected: str) -> None:
    (tmp_path / "m.csv").write_text(text)
    [problem] = problems(TERRAIN + f"nodes: {{r: {{{node}}}}}", directory=tmp_path)
    assert problem.startswith(f"s.yaml:6: {expected}")


def test_a_common_motion_file_names_its_nodes(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("at_s,x,y\n0,1,1\n")
    [problem] = problems("duration: 9s\nmotion: {file: m.csv}\nnodes: {a: }", directory=tmp_path)
    assert problem.startswith("s.yaml:2: motion: 'm.csv' does not say whose motion it is; add a column node")


@pytest.mark.parametrize(
    ("nodes", "expected"),
    [
        (
            "r: {position: [60, 10]}",
            "s.yaml:6: nodes.r.position: [60, 10] lies in the rock; the nearest tunnel is 'adit'",
        ),
        ("r: {waypoints: [[0, 0], [60, 9]], speed: 1m/s}", "s.yaml:6: nodes.r.waypoints[1]: [60, 9] lies in the rock"),
        ("r: {waypoints: [[0, 9], [6, 0]], speed: 1m/s}", "s.yaml:6: nodes.r.waypoints[0]: [0, 9] lies in the rock"),
        ("r: {position: [0, 0], waypoints: [[6, 9]], speed: 1m/s}", "s.yaml:6: nodes.r.waypoints[0]: [6, 9] lies in"),
    ],
)
def test_rock_is_found_before_anything_starts(nodes: str, expected: str) -> None:
    [problem] = problems(TERRAIN + f"nodes: {{{nodes}}}")
    assert expected in problem


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        (
            "{at: 1s, deploy: r}",
            "s.yaml:3: events[0].deploy: nobody carries 'r'; add carried_by to it, or remove the event",
        ),
        ("{at: 1s, deploy: x}", "s.yaml:3: events[0].deploy: node 'x' is not defined"),
        ("{at: 1s, deploy: b}, {at: 2s, deploy: b}", "events[1].deploy: 'b' is dropped twice (first by events[0])"),
        ("{at: 1s, move: {node: x, to: [0, 0]}}", "s.yaml:3: events[0].move.node: node 'x' is not defined"),
        ("{at: 1s, move: {node: b, to: [0, 0]}}", "s.yaml:3: events[0].move.node: 'b' is still carried then; let it"),
        ("{at: 1s, kill: {node: b, process: p}}", "s.yaml:3: events[0].kill.node: 'b' is still carried then; let it"),
        ("{at: 1s, move: {node: r, to: [0]}}", "s.yaml:3: events[0].move.to: expected [x, y] or [x, y, z]"),
    ],
)
def test_wrong_deployments_and_moves(events: str, expected: str) -> None:
    nodes = "nodes: {r: , b: {carried_by: r, processes: [{argv: [sleep], name: p}]}}"
    [problem] = problems(f"duration: 9s\n{nodes}\nevents: [{events}]")
    assert expected in problem


def test_a_move_into_the_rock() -> None:
    [problem] = problems(TERRAIN + "nodes: {r: }\nevents: [{at: 1s, move: {node: r, to: [0, 50]}}]")
    assert problem.startswith("s.yaml:7: events[0].move.to: [0, 50] lies in the rock")


def test_tunnels_that_do_not_meet_are_told_by_the_way_that_is_missing() -> None:
    far = "    - {name: far, path: [[0, 50], [9, 50]], width: 3m}\n"
    [problem] = problems(TERRAIN + far + "nodes: {r: {waypoints: [[0, 0], [5, 50]], speed: 1m/s}}")
    assert problem.startswith("s.yaml:7: nodes.r.waypoints[1]: no tunnel leads from [0, 0] to [5, 50]")


@pytest.mark.parametrize(
    ("tunnels", "expected"),
    [
        ("{name: a, path: [[0, 0]], width: 4m}", "tunnels[0].path: has 1 entries; give at least 2"),
        ("{name: a, path: [[0, 0], [0, 0]], width: 4m}", "tunnels[0]: path[1] is where path[0] is; remove one"),
        ("{name: a, path: [[0, 0], [9, 0]], width: 4}", "tunnels[0].width: 4 has no unit; write a length like 4m"),
        ("{name: a, path: [[0, 0], [9, 0]], width: 0m}", "tunnels[0].width: '0m' is impossible; it must be above zero"),
        ("{name: a, path: [[0, 0], [9, 0]]}", "tunnels[0].width: is missing; add it"),
        (
            "{name: a, path: [[0, 0], [9, 0]], width: 4m, material: limstone}",
            "tunnels[0].material: unknown material 'limstone'; did you mean 'limestone'?",
        ),
        (
            "{name: a, path: [[0, 0], [9, 0]], width: 4m, material: {permittivity: 1}}",
            "tunnels[0].material.permittivity: '1' is impossible; it must be above 1",
        ),
    ],
)
def test_wrong_tunnels(tunnels: str, expected: str) -> None:
    [problem] = problems(f"duration: 9s\nterrain:\n  tunnels: [{tunnels}]\nnodes: {{a: }}")
    assert problem.startswith(f"s.yaml:3: terrain.{expected}")


@pytest.mark.parametrize(
    ("motion", "text", "expected"),
    [
        ("{file: m.csv}", "at_s,node,x,y\n0,z,1,1\n", "s.yaml:2: motion.file: m.csv: node 'z' is not defined"),
        ("{file: m.csv}", "at_s,node,x,y\n0,a,1\n", "s.yaml:2: motion: m.csv:2: 3 cells; there must be 4"),
        ("{file: m.csv}", "at_s,node,x,y\n0,w,1,1\n", "s.yaml:3: nodes.w.waypoints: the motion of 'w' is in m.csv"),
        ("{file: m.csv, nodes: [a]}", "at_s,node,x,y\n0,a,1,1\n", "s.yaml:2: motion: 'm.csv' names its nodes itself"),
        ("{file: m.txt}", "", "s.yaml:2: motion: 'm.txt' does not tell its format; add format:"),
        ("{file: m.tcl}", "$node_(0) set X_ 1.0\n", "s.yaml:2: motion: 'm.tcl' counts its nodes; add nodes:"),
        ("{file: m.tcl, nodes: [a]}", "$node_(1) set X_ 1.0\n", "s.yaml:2: motion: 'm.tcl' has a node 1, and nodes"),
        ("{file: no.csv}", "", "s.yaml:2: motion: cannot read 'no.csv': No such file"),
    ],
)
def test_wrong_motion_files(tmp_path: Path, motion: str, text: str, expected: str) -> None:
    name = motion.removeprefix("{file: ").rstrip("}").partition(",")[0]
    if name != "no.csv":
        (tmp_path / name).write_text(text)
    source = f"duration: 9s\nmotion: {motion}\nnodes: {{a: , w: {{waypoints: [[0, 0]]}}}}"
    [problem] = problems(source, directory=tmp_path)
    assert problem.startswith(expected)


def test_a_lab_of_wires_does_without_numpy() -> None:
    code = (
        "import sys; from netlab.scenario import parse_scenario; "
        "parse_scenario('duration: 1s\\nnodes: {a: {waypoints: [[0, 0], [1, 1]], speed: 1m/s}}'); "
        "sys.exit('numpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_scenario_that_is_cut_short_leaves_out_what_comes_later() -> None:
    events = "[{at: 5s, move: {node: a, to: [9, 9]}}, {at: 50s, deploy: b}]"
    text = f"duration: 60s\nnodes: {{a: , b: {{carried_by: a}}}}\nevents: {events}"
    scenario = parse_scenario(text, overrides=["duration=20s"])
    assert [entry.at_s for entry in compile_timeline(scenario, compile_plan(scenario))] == [5]
    [problem] = problems(text.replace("60s", "20s"))
    assert problem == "s.yaml:3: events[1].at: 50s is not before the end; duration is 20s"


def test_motion_stands_still_while_it_is_held() -> None:
    holds = [(2.0, 3.0), (10.0, 1.0)]
    assert [earlier(at_s, holds) for at_s in (1.0, 2.0, 4.0, 5.0, 6.0, 10.5, 12.0)] == [1, 2, 2, 2, 3, 7, 8]
    assert [later(motion_s, holds) for motion_s in (1.0, 2.0, 3.0, 7.0, 8.0)] == [1, 2, 6, 10, 12]


def test_holds_that_overlap_are_one() -> None:
    events = [{"at": at, "hold": length} for at, length in (("5s", "2s"), ("1s", "3s"), ("2s", "4s"))]
    scenario = parse_scenario({"duration": "60s", "nodes": {"a": {}}, "events": events})
    assert scenario.holds == ((1.0, 6.0),)


def test_a_relay_falls_where_its_carrier_has_come_to_by_then() -> None:
    nodes = {"a": {"waypoints": [[0, 0], [100, 0]], "speed": "1m/s"}, "b": {"carried_by": "a"}}
    events = [{"at": "2s", "hold": "5s"}, {"at": "10s", "deploy": "b"}]
    scenario = parse_scenario({"duration": "60s", "nodes": nodes, "events": events})
    assert tracks(scenario)[1].at(30.0).position_m == (5.0, 0.0, 0.0)
