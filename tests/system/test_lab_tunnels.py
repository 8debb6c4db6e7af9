"""Radios in tunnels: who is in contact when, in a lab and in its capture; in virtual time, where figures are exact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from netlab.pytest_plugin import MakeLab

TOPOLOGIES = Path(__file__).parents[2] / "topologies"


def corner(**propagation: Any) -> dict[str, Any]:
    scenario: dict[str, Any] = yaml.safe_load((TOPOLOGIES / "corner.yaml").read_text())
    scenario["radio"]["propagation"] |= propagation
    return scenario


@pytest.mark.lab_clock("virtual")
def test_a_robot_behind_the_corner_comes_back(make_lab: MakeLab) -> None:
    result = make_lab(TOPOLOGIES / "corner.yaml", packets=False).run()
    assert result.passed, result.report()
    assert len(result.summary["reconnects"]) == 1


@pytest.mark.lab_clock("virtual")
def test_contact_ends_and_returns_where_the_model_says(make_lab: MakeLab) -> None:
    # Without fading: in sight of (0, 0) up to the y where 100 y / hypot(100, y) is half a width, 2 m: y = 2.0004 m. At
    # 2.5 m/s from (60, 0) that is at (40 + 2.0004) / 2.5 = 16.80 s; the robot pauses 3 s at 25 m, from 26 to 29 s, and
    # is back in sight at 29 + (25 - 2.0004) / 2.5 = 38.20 s. A tick is 0.05 s. The end of a cut restores nothing there.
    scenario = corner(fading=False, shadowing="0dB")
    scenario["events"] = [{"at": "20s", "outage": {"between": ["base", "robot"], "for": "5s"}}]
    result = make_lab(scenario, packets=False).run()
    steps = {step.label: result.trace.seconds(step.t_ns) for step in result.trace.timeline}
    assert steps["base and robot lose each other"] == pytest.approx(16.80, abs=0.06)
    assert steps["base and robot hear each other"] == pytest.approx(38.20, abs=0.06)
    [reconnect] = result.summary["reconnects"]
    assert reconnect["restored_at_s"] == pytest.approx(38.20, abs=0.06)
    assert reconnect["delay_s"] < 0.2


@pytest.mark.lab_clock("virtual")
def test_a_cut_outlasts_the_way_back(make_lab: MakeLab) -> None:
    scenario = corner(fading=False, shadowing="0dB")
    scenario["events"] = [{"at": "20s", "outage": {"between": ["base", "robot"], "for": "22s"}}]
    result = make_lab(scenario, packets=False).run()
    [reconnect] = result.summary["reconnects"]
    assert reconnect["restored_at_s"] == pytest.approx(42.0, abs=0.01)


@pytest.mark.lab_clock("virtual")
def test_a_chain_of_dropped_relays_keeps_the_robot_in_contact(make_lab: MakeLab) -> None:
    result = make_lab(TOPOLOGIES / "beacon_drop.yaml", packets=False).run()
    assert result.passed, result.report()


@pytest.mark.lab_clock("virtual")
def test_without_relays_the_robot_is_lost(make_lab: MakeLab) -> None:
    result = make_lab(TOPOLOGIES / "beacon_drop.yaml", overrides=["events=[]", "duration=40s"], packets=False).run()
    [delivered] = [row for row in result.expectations if row.name.startswith("delivered of telemetry")]
    assert not delivered.passed
    assert delivered.measured is not None
    assert delivered.measured < 0.8


@pytest.mark.lab_clock("virtual")
def test_three_seconds_of_contact_carry_the_most_urgent_and_the_rest_comes_later(make_lab: MakeLab) -> None:
    result = make_lab(TOPOLOGIES / "data_ferry.yaml", packets=False).run()
    assert result.passed, result.report()
    trace = result.trace
    made = [trace.seconds(step.t_ns) for step in trace.timeline if "hear each other" in step.label]
    assert made == pytest.approx([20.75, 35.55], abs=0.06)
    artifacts, maps = ([trace.seconds(d.t_ns) for d in trace.delivered[stream]] for stream in (0, 1))
    in_contact = [at_s for at_s in maps if made[0] <= at_s < made[0] + 3.1]
    waiting = [at_s for at_s in artifacts if made[0] <= at_s < min(in_contact)]
    assert len(waiting) >= 18, "the artifacts of the last 19 s come first"
    assert len(in_contact) * 20_000 * 8 / 3.0 > 3.5e6, "whole maps, at most of the channel's pace"
