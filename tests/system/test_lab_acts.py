"""What a person does to a running lab: each act takes effect, is recorded, can be undone and is replayed by a file."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind
from netlab.errors import LabError
from netlab.lab.facade import Lab
from netlab.pytest_plugin import MakeLab
from netlab.scenario import load_scenario

SCENARIO = """
name: acts
duration: 30s
engine: air
radio: {propagation: {model: none}}
nodes:
  base:   {position: [0, 0], processes: [udp_mesh]}
  robot:  {waypoints: [[10, 0], [1000, 0]], speed: 1m/s, processes: [udp_mesh]}
  wired:  {position: [0, 9], radio: none, processes: [udp_mesh]}
  beacon: {carried_by: robot, processes: [udp_mesh]}
links:
  - {between: [base, wired], rate: 10mbit, delay: 1ms}
traffic:
  - {from: robot, to: base, topic: telemetry, priority: 1, size: 100B, rate: 20Hz}
events:
  - {at: 27s, deploy: beacon}                        # far away
  - {at: 28s, outage: {between: [base, robot], for: 1s}}
"""


def until(condition: Callable[[], Any], *, within_s: float = 20.0) -> Any:
    """Wait for a condition, not for a time."""
    deadline = time.monotonic() + within_s
    while not (value := condition()):
        assert time.monotonic() < deadline, "this never came"
        time.sleep(0.02)
    return value


@pytest.fixture
def lab(make_lab: MakeLab) -> Lab:
    lab = make_lab(yaml.safe_load(SCENARIO), packets=False)
    lab.begin()
    return lab


def state(lab: Lab, a: str, b: str) -> str:
    [found] = {row["state"] for row in lab.status()["links"] if (row["from"], row["to"]) == (a, b)}
    return str(found)


def process(lab: Lab, node: str) -> str:
    [found] = [row["state"] for row in lab.status()["processes"] if (row["node"], row["process"]) == (node, "udp_mesh")]
    return str(found)


def test_cut_and_undo(lab: Lab) -> None:
    lab.act("outage", between=["base", "robot"], active=True, one_way=True)
    assert (state(lab, "base", "robot"), state(lab, "robot", "base")) == ("outage", "up")
    assert lab.status()["undo"] == "outage base->robot begins"
    assert lab.act("undo")["label"] == "outage base->robot begins"
    assert state(lab, "base", "robot") == "up"
    with pytest.raises(LabError, match="nothing to undo"):
        lab.act("undo")


def test_pull_a_cable_and_undo(lab: Lab) -> None:
    lab.act("carrier", between=["base", "wired"], up=False)
    assert state(lab, "base", "wired") == "no_carrier"
    lab.act("undo")
    assert state(lab, "wired", "base") == "up"


def test_flap_and_undo(lab: Lab) -> None:
    lab.act("flap", between=["base", "robot"], up_s=0.1, down_s=0.1, for_s=20.0)
    until(lambda: state(lab, "base", "robot") == "outage")
    until(lambda: state(lab, "base", "robot") == "up")
    until(lambda: state(lab, "base", "robot") == "outage")
    with pytest.raises(LabError, match="flaps already"):
        lab.act("flap", between=["robot", "base"], up_s=1, down_s=1, for_s=1)
    lab.act("undo")
    assert state(lab, "base", "robot") == "up"
    with pytest.raises(LabError, match="does not flap"):
        lab.act("flap_end", between=["base", "robot"])


def test_a_flap_ends_by_itself_with_the_link_up(lab: Lab) -> None:
    lab.act("flap", between=["base", "wired"], up_s=0.05, down_s=0.05, for_s=0.3)
    until(lambda: [row["kind"] for row in journal(lab)].count("flap_up") >= 1)
    until(lambda: flaps_again(lab))
    assert state(lab, "base", "wired") == "up"


def flaps_again(lab: Lab) -> bool:
    """Whether the former flap is over, so that another one (a very short one) may begin and end."""
    try:
        lab.act("flap", between=["base", "wired"], up_s=0.01, down_s=0.01, for_s=0.01)
    except LabError:
        return False
    return until(lambda: journal(lab)[-1]["kind"] == "flap_up") is True


def test_degrade_and_undo(lab: Lab) -> None:
    lab.act("link", between=["base", "wired"], words={"delay": "150ms", "rate": "1mbit"})
    ping = lab.exec("base", "ping", "-c1", "-W3", "wired").stdout
    assert float(ping.split("time=")[1].split()[0]) > 290
    lab.act("undo")
    ping = lab.exec("base", "ping", "-c1", "-W3", "wired").stdout
    assert float(ping.split("time=")[1].split()[0]) < 150


def test_move_and_undo(lab: Lab) -> None:
    def place(node: str) -> float:
        with lab.feed() as feed:
            while True:
                for record in map(feed.decode, feed.receive(timeout_s=10.0)):
                    if isinstance(record, JsonRecord) and record.kind is Kind.POSES:
                        nodes: Any = record.payload["nodes"]
                        poses: Any = record.payload["poses"]
                        return float(poses[nodes.index(node)]["position"]["x"])

    lab.act("move", node="base", to=[-50, 0])
    until(lambda: place("base") == -50)
    lab.act("undo")
    until(lambda: place("base") == 0)


def test_deploy_early_is_not_done_again_and_not_undone(lab: Lab) -> None:
    assert state(lab, "beacon", "base") == "outage"
    lab.act("deploy", node="beacon")
    until(lambda: state(lab, "beacon", "base") == "up")
    until(lambda: process(lab, "beacon") == "ready")
    assert [row["label"] for row in lab.status()["coming"]] == ["outage base-robot begins", "outage base-robot ends"]
    with pytest.raises(LabError, match="on the ground already"):
        lab.act("deploy", node="beacon")
    with pytest.raises(LabError, match="nobody carries 'base'; carried in this scenario: beacon"):
        lab.act("deploy", node="base")
    with pytest.raises(LabError, match="nobody picks it up"):
        lab.act("undo")


def test_kill_and_undo(lab: Lab) -> None:
    lab.act("kill", node="wired", process="udp_mesh")
    assert process(lab, "wired") == "exited"
    lab.act("undo")
    assert process(lab, "wired") == "ready"
    with pytest.raises(LabError, match="is ready already"):
        lab.act("start", node="wired", process="udp_mesh")


def test_the_timeline_stands_still_while_traffic_goes_on(lab: Lab) -> None:
    with pytest.raises(LabError, match="is going on"):
        lab.act("resume")
    lab.act("hold")
    sent = lab.status()["streams"].get("0", {}).get("sent", 0)
    before = lab.status()
    assert before["held"]
    until(lambda: lab.status()["streams"].get("0", {}).get("sent", 0) > sent + 10)
    after = lab.status()
    assert [row["label"] for row in after["coming"]] == [row["label"] for row in before["coming"]]
    passed_s = after["t_s"] - before["t_s"]
    assert after["coming"][0]["at_s"] - before["coming"][0]["at_s"] == pytest.approx(passed_s, abs=0.02)
    assert after["end_s"] - before["end_s"] == pytest.approx(passed_s, abs=0.02)
    lab.act("resume")
    assert not lab.status()["held"]


def test_step_carries_out_the_next_event_at_once(lab: Lab) -> None:
    lab.act("hold")
    assert lab.act("step")["labels"] == ["deploy beacon"]
    until(lambda: state(lab, "beacon", "base") == "up")
    assert lab.act("step")["labels"] == ["outage base-robot begins"]
    assert state(lab, "base", "robot") == "outage"
    assert lab.act("step")["labels"] == ["outage base-robot ends"]
    assert state(lab, "base", "robot") == "up"
    with pytest.raises(LabError, match="nothing comes any more"):
        lab.act("step")


def test_a_run_is_longer_by_its_holds_and_traffic_fills_it(make_lab: MakeLab) -> None:
    lab = make_lab(yaml.safe_load(SCENARIO), overrides=["duration=2s"], packets=False)
    lab.begin()
    lab.act("hold")
    held = until(lambda: (status := lab.status())["t_s"] > 2.5 and status)
    assert held["phase"] == "running"
    lab.act("resume")
    end_s = lab.status()["end_s"]
    assert end_s > 4.0
    result = lab.finish()
    assert result.summary["duration_s"] == pytest.approx(end_s)
    [stream] = result.summary["streams"]
    assert stream["sent"] == pytest.approx(20 * end_s, abs=3)


def test_recordings_end_and_begin(lab: Lab, tmp_path: Path) -> None:
    first, second = lab.capture, tmp_path / "second.mcap"
    lab.act("mark", text="in the first")
    lab.act("record", file=None)
    assert lab.status()["recording"] is None
    with Capture.open(first) as capture:
        assert not capture.notes  # finished, while the lab goes on
    lab.act("mark", text="in none")
    lab.act("record", file=str(second))
    lab.act("mark", text="in the second")
    lab.act("record", file=None)
    with Capture.open(second) as capture:
        marks = [r.text("label") for r in capture.records({Kind.TIMELINE}) if isinstance(r, JsonRecord)]
        assert "in the second" in marks
        assert "in none" not in marks
        assert "t0_ns" in capture.metadata
    with pytest.raises(LabError, match="No such file or directory"):
        lab.act("record", file=str(tmp_path / "nowhere" / "x.mcap"))


def test_what_was_done_is_saved_and_happens_again(lab: Lab, tmp_path: Path, make_lab: MakeLab) -> None:
    lab.act("outage", between=["base", "robot"], active=True)
    lab.act("link", between=["base", "wired"], words={"delay": "80ms"})
    lab.act("kill", node="wired", process="udp_mesh")
    lab.act("start", node="wired", process="udp_mesh")
    lab.act("outage", between=["base", "robot"], active=False)
    lab.act("move", node="base", to=[5, 5])
    lab.act("undo")
    lab.act("deploy", node="beacon")
    lab.act("mark", text="look here")
    lab.act("hold")
    lab.act("step")
    lab.act("resume")
    file = tmp_path / "again.yaml"
    assert lab.save(file) == ()
    done = [row for row in journal(lab) if "act" in row or "event" in row]
    saved = load_scenario(file)
    assert saved.events[-1].at_s <= saved.duration_s
    again = make_lab(file, overrides=[f"duration={max(e.at_s for e in saved.events) + 3:.3f}s"], packets=False)
    result = again.run()
    assert not result.problems
    repeated = [row for row in journal_of(again) if row["kind"] not in ("start", "end", "exit")]
    wanted = {"outage", "outage_end", "link", "kill", "start_process", "move", "deploy", "mark", "hold", "resume"}
    assert {row["kind"] for row in repeated} == wanted
    for kind, label in (("mark", "look here"), ("deploy", "deploy beacon"), ("kill", "kill udp_mesh on wired")):
        [first] = [row["at_s"] for row in done if (row["kind"], row["label"]) == (kind, label)]
        [second] = [row["at_s"] for row in repeated if (row["kind"], row["label"]) == (kind, label)]
        assert second == pytest.approx(first, abs=0.002)


def journal(lab: Lab) -> list[dict[str, Any]]:
    from netlab.lab.saving import read_journal

    return [dict(row.payload) for row in read_journal(lab._running.folder.journal)]


def journal_of(lab: Lab) -> list[dict[str, Any]]:
    with Capture.open(lab.capture) as capture:
        return [record.payload for record in capture.records({Kind.TIMELINE}) if isinstance(record, JsonRecord)]
