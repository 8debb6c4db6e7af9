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
    # is back in sight at 29 + (25 - 2.0004) / 2.5 = 38.20 s. A tick is 0.05 s.
    result = make_lab(corner(fading=False, shadowing="0dB"), packets=False).run()
    steps = {step.label: result.trace.seconds(step.t_ns) for step in result.trace.timeline}
    assert steps["base and robot lose each other"] == pytest.approx(16.80, abs=0.06)
    assert steps["base and robot hear each other"] == pytest.approx(38.20, abs=0.06)
    [reconnect] = result.summary["reconnects"]
    assert reconnect["delay_s"] < 0.2


@pytest.mark.lab_clock("virtual")
def test_what_is_cut_behind_the_corner_is_restored_by_coming_back(make_lab: MakeLab) -> None:
    scenario = corner(fading=False, shadowing="0dB")
    scenario["events"] = [{"at": "20s", "outage": {"between": ["base", "robot"], "for": "5s"}}]
    result = make_lab(scenario, packets=False).run()
    [reconnect] = result.summary["reconnects"]
    assert reconnect["restored_at_s"] == pytest.approx(38.20, abs=0.06)


@pytest.mark.lab_clock("virtual")
def test_a_cut_outlasts_the_way_back(make_lab: MakeLab) -> None:
    scenario = corner(fading=False, shadowing="0dB")
    scenario["events"] = [{"at": "20s", "outage": {"between": ["base", "robot"], "for": "25s"}}]
    result = make_lab(scenario, packets=False).run()
    [reconnect] = result.summary["reconnects"]
    assert reconnect["restored_at_s"] == pytest.approx(45.0, abs=0.01)
