"""What udp_mesh promises on bad paths, as users see it: whole scenarios, in virtual time, judged as the files say.

In real time the same scenarios show the machine's own pauses; there the looser expectations of ``bottleneck`` hold.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from netlab.pytest_plugin import MakeLab

pytestmark = pytest.mark.lab_clock("virtual")

TOPOLOGIES = Path(__file__).parents[2] / "topologies"

# 20.3 ms is the delay and the message's own serialisation; the link carries 9.45 Mbit/s after headers.
TIGHT = (
    "expect=[{latency: {topic: telemetry}, p50: 22.3ms, p99: 25.3ms}, {delivered: {topic: telemetry}, min: 100%},"
    " {goodput: {topic: bulk}, min: 8.98mbit}, {priority_inversions: {at: robot1}, max: 0}]"
)


def test_bulk_fills_the_bottleneck_and_telemetry_does_not_notice(make_lab: MakeLab) -> None:
    smaller = ("traffic.1.size=50kB", "traffic.1.rate=32Hz")  # so that an unfinished message hardly counts
    result = make_lab(TOPOLOGIES / "bottleneck.yaml", overrides=(TIGHT, *smaller)).run()
    assert not [row.name for row in result.expectations if not row.passed], result.report()


@pytest.mark.parametrize("name", ["lossy_bottleneck", "lossy_far"])
def test_losses_cost_little(make_lab: MakeLab, name: str) -> None:
    result = make_lab(TOPOLOGIES / f"{name}.yaml").run()
    assert not [row.name for row in result.expectations if not row.passed], result.report()


def test_without_redundancy_a_loss_costs_a_round_trip(make_lab: MakeLab) -> None:
    """The goal of ``alarm`` is not met by chance."""
    result = make_lab(TOPOLOGIES / "lossy_bottleneck.yaml", overrides=("traffic.1.redundancy=1",)).run()
    assert [row.name for row in result.expectations if not row.passed and "alarm" in row.name], result.report()


def test_ten_robots_on_one_channel_yield_to_each_others_telemetry(make_lab: MakeLab) -> None:
    result = make_lab(TOPOLOGIES / "shared_channel.yaml", engine="air").run()
    assert not [row.name for row in result.expectations if not row.passed], result.report()


def test_without_coordination_telemetry_waits_for_the_others_video(make_lab: MakeLab) -> None:
    """The same channel, the same traffic: what the radio gives everyone in turn is not enough."""
    overrides = ("udp_mesh.coordinate=false", "duration=5s")
    result = make_lab(TOPOLOGIES / "shared_channel.yaml", engine="air", overrides=overrides).run()
    assert [row.name for row in result.expectations if not row.passed and "telemetry" in row.name], result.report()
