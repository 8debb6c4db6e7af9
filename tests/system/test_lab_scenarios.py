"""The scenarios that ship with the project meet their expectations, and fail when what they rest on is switched off.

They assert on real time, so they run alone (``make test`` does), and a run during which the machine itself stood still
is repeated: it says nothing about the network. In virtual time (``make test-vm``) nothing is ever repeated.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from netlab.lab.stalls import NOTABLE_S
from netlab.pytest_plugin import MakeLab

pytestmark = pytest.mark.real_time

TOPOLOGIES = Path(__file__).parents[2] / "topologies"
TRIES = 4


def _failed(make_lab: MakeLab, name: str, *overrides: str) -> tuple[str, list[str]]:
    """Report and unmet expectations of the first run, of at most ``TRIES``, during which the machine kept up."""
    for _ in range(TRIES):
        lab = make_lab(TOPOLOGIES / f"{name}.yaml", overrides=overrides)
        assert lab.scenario.expect
        result = lab.run()
        report, failed = result.report(), [row.name for row in result.expectations if not row.passed]
        if not failed or result.worst_stall_s < NOTABLE_S:
            break
        print(f"the machine stood still for {result.worst_stall_s:.3f} s:\n{report}")
        lab.close()
    return report, failed


@pytest.mark.parametrize("name", ["pair", "bottleneck", "outage", "flapping", "lossy", "star", "line"])
def test_every_scenario_meets_its_expectations(make_lab: MakeLab, name: str) -> None:
    report, failed = _failed(make_lab, name)
    assert not failed, report


def test_without_prioritisation_telemetry_waits_behind_bulk(make_lab: MakeLab) -> None:
    report, failed = _failed(make_lab, "bottleneck", "udp_mesh.prioritise=false")
    assert any(name.startswith("latency of telemetry") for name in failed), report
    assert any("inversions" in name for name in failed), report


@pytest.mark.parametrize("probe", [True, False], ids=["probing", "not probing"])
def test_probing_makes_the_reconnect_fast(make_lab: MakeLab, probe: bool) -> None:
    # Rare beacons: at one a second, chance alone makes the expectation hold now and then without any probe.
    overrides = ("udp_mesh.beacon_interval=30s", f"udp_mesh.probe={str(probe).lower()}")
    report, failed = _failed(make_lab, "outage", *overrides)
    assert any(name.startswith("reconnect") for name in failed) is not probe, report


def test_the_line_grows_with_one_override(make_lab: MakeLab) -> None:
    lab = make_lab(TOPOLOGIES / "line.yaml", overrides=["generate.count=12"])
    assert len(lab.status()["nodes"]) == 12
