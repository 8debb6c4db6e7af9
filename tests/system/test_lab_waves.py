"""Radios that go by positions, in a lab: what is heard follows who is where, and the capture says so."""

from __future__ import annotations

import math

import pytest
import yaml

from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind, VerdictRecord
from netlab.errors import LabError
from netlab.lab.facade import Lab
from netlab.medium.verdicts import Verdict
from netlab.pytest_plugin import MakeLab

SCENARIO = """
duration: 2s
radio:
  phy: 802.11g-20MHz
  rate: 6mbit
  propagation: {model: log_distance, exponent: 3}
nodes:
  base: {position: [0, 0], processes: [udp_mesh], radio: {tx_power: 26dBm}}
  robot: {waypoints: [[20, 0], [420, 0]], speed: 200m/s, processes: [udp_mesh]}
  far: {position: [5000, 0], processes: [udp_mesh]}
traffic:
  - {from: robot, to: base, topic: telemetry, size: 100B, rate: 50Hz, reliability: best_effort}
  - {from: far, to: base, topic: telemetry, size: 100B, rate: 5Hz, reliability: best_effort}
"""
#: 20 dBm, 40.2 dB at one metre, 30 dB per decade, -91 dBm of noise: 4 dB are left at this distance.
RANGE_M = 10 ** ((20 - 40.2 + 91 - 4) / 30)


def heard_dbm(t_s: float, *, power_dbm: float = 20.0) -> float:
    """How strongly base hears the robot at a scenario time, and with its own power the robot base."""
    return power_dbm - 40.2 - 30 * math.log10(20 + 200 * max(0.0, t_s))


def test_a_robot_drives_out_of_range(make_lab: MakeLab) -> None:
    lab = make_lab(yaml.safe_load(SCENARIO))
    assert lab.exec("robot", "ping", "-c1", "-W2", "base").returncode == 0
    assert lab.exec("far", "ping", "-c1", "-W1", "base").returncode != 0
    with pytest.raises(LabError, match="rssi follows places, or a measured file, here; move a node, or set loss"):
        lab.link("base", "robot", rssi="-50dBm")
    result = lab.run()
    assert not result.problems
    _assert_strengths_follow_the_robot(lab)
    _assert_links_are_recorded(lab)
    robot, far = result.summary["streams"]
    last_s = (RANGE_M - 20) / 200
    assert 50 * last_s * 0.6 < robot["delivered"] < 50 * (last_s + 0.3)
    assert far["delivered"] == 0


def _assert_strengths_follow_the_robot(lab: Lab) -> None:
    seen = 0
    with Capture.open(lab.capture) as capture:
        for record in capture.records({Kind.VERDICT}):
            assert isinstance(record, VerdictRecord)
            ends = record.sender[0], record.receiver[0]
            t_s = (record.t_ns - capture.t0_ns) / 1e9
            if set(ends) == {"base", "robot"} and record.verdict is Verdict.DELIVERED and 0.0 < t_s < 2.0:
                power_dbm = 26.0 if ends[0] == "base" else 20.0
                bounds = heard_dbm(t_s, power_dbm=power_dbm), heard_dbm(t_s - 0.2, power_dbm=power_dbm)
                assert record.rssi_dbm is not None
                assert bounds[0] - 1 <= record.rssi_dbm <= bounds[1] + 1, t_s
                seen += 1
    assert seen > 30


def _assert_links_are_recorded(lab: Lab) -> None:
    with Capture.open(lab.capture) as capture:
        rows = [r.payload for r in capture.records({Kind.LINKS}) if isinstance(r, JsonRecord)]
    mine = [row for row in rows if (row["from"], row["to"]) == ("robot", "base") and "snr_db" in row]
    assert mine[0]["state"] == "up"
    assert abs(float(mine[0]["snr_db"]) - (heard_dbm(0.0) + 91)) < 1  # type: ignore[arg-type]
    assert mine[-1]["state"] == "out_of_range"
    assert len(mine) <= 8  # a pair out of range is not told again and again


@pytest.mark.usefixtures("netem_kernel")
def test_netem_loses_the_same_robot_at_the_same_place(make_lab: MakeLab) -> None:
    lab = make_lab({**yaml.safe_load(SCENARIO), "engine": "netem"})
    assert lab.exec("robot", "ping", "-c1", "-W2", "base").returncode == 0
    assert lab.exec("far", "ping", "-c1", "-W1", "base").returncode != 0
    result = lab.run()
    assert not result.problems
    _assert_links_are_recorded(lab)
    robot, far = result.summary["streams"]
    last_s = (RANGE_M - 20) / 200
    assert 50 * last_s * 0.6 < robot["delivered"] < 50 * (last_s + 0.4)
    assert far["delivered"] == 0


MARSUPIAL = """
duration: 1s
mesh: flood
radio: {phy: 802.11g-20MHz, propagation: {model: free_space}}
nodes:
  base: {position: [0, 0]}
  parent: {position: [50, 0], radio: [{}, {frequency: 5.18GHz, phy: 802.11n-20MHz-2x2, tx_power: 10dBm}]}
  uav: {position: [60, 0], radio: {frequency: 5.18GHz, phy: 802.11n-20MHz-2x2, tx_power: 10dBm}}
"""


@pytest.mark.usefixtures("taps")
def test_a_parent_with_two_radios_joins_two_channels(make_lab: MakeLab) -> None:
    lab = make_lab(yaml.safe_load(MARSUPIAL))
    assert lab.exec("base", "ping", "-c2", "-W2", "uav").returncode == 0
    lab.run()
    heard = set()
    with Capture.open(lab.capture) as capture:
        for record in capture.records({Kind.VERDICT}):
            assert isinstance(record, VerdictRecord)
            if record.verdict is Verdict.DELIVERED:
                heard.add((record.sender, record.receiver))
    parent = ("parent", "radio0"), ("parent", "radio1")
    there = {(("base", "radio0"), parent[0]), (parent[1], ("uav", "radio0"))}
    assert heard == there | {(b, a) for a, b in there}
