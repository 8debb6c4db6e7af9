"""The scenarios that ship with the project meet their expectations, and fail when what they rest on is switched off."""

from __future__ import annotations

from pathlib import Path

import pytest

from netlab.lab.facade import Lab
from netlab.pytest_plugin import MakeLab

TOPOLOGIES = Path(__file__).parents[2] / "topologies"


def _failed(lab: Lab) -> tuple[str, list[str]]:
    result = lab.run()
    return result.report(), [row.name for row in result.expectations if not row.passed]


@pytest.mark.parametrize("name", ["pair", "bottleneck", "outage", "flapping", "lossy", "star", "line"])
def test_every_scenario_meets_its_expectations(make_lab: MakeLab, name: str) -> None:
    lab = make_lab(TOPOLOGIES / f"{name}.yaml")
    assert lab.scenario.expect
    report, failed = _failed(lab)
    assert not failed, report


def test_without_prioritisation_telemetry_waits_behind_bulk(make_lab: MakeLab) -> None:
    report, failed = _failed(make_lab(TOPOLOGIES / "bottleneck.yaml", overrides=["udp_mesh.prioritise=false"]))
    assert any(name.startswith("latency of telemetry") for name in failed), report
    assert any("inversions" in name for name in failed), report


@pytest.mark.parametrize("probe", [True, False], ids=["probing", "not probing"])
def test_probing_makes_the_reconnect_fast(make_lab: MakeLab, probe: bool) -> None:
    # Rare beacons: at one a second, chance alone makes the expectation hold now and then without any probe.
    overrides = ["udp_mesh.beacon_interval=30s", f"udp_mesh.probe={str(probe).lower()}"]
    report, failed = _failed(make_lab(TOPOLOGIES / "outage.yaml", overrides=overrides))
    assert any(name.startswith("reconnect") for name in failed) is not probe, report


def test_the_line_grows_with_one_override(make_lab: MakeLab) -> None:
    lab = make_lab(TOPOLOGIES / "line.yaml", overrides=["generate.count=12"])
    assert len(lab.status()["nodes"]) == 12
