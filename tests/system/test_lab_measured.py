"""Measured links in a lab, on both engines: strengths over time decide who is heard, words between rows follow.

In virtual time: one expectation is a time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind
from netlab.lab.facade import Lab
from netlab.pytest_plugin import MakeLab
from netlab.scenario import parse_scenario

pytestmark = pytest.mark.lab_clock("virtual")


@pytest.fixture(params=["air", "netem"])
def engine(request: pytest.FixtureRequest) -> str:
    """Both engines, where the kernel has them."""
    if request.param == "netem":
        request.getfixturevalue("netem_kernel")
    return str(request.param)


#: a and b lose each other between 3 and 5 s, and meet again from 7 s on. The noise is -91 dBm, a's power 20 dBm, b's
#: 26 dBm: of frames of a that lose more than 109 dB few arrive. c hears a better and better until 8 s.
LOSSES = """\
# walk of the fourth of May
at_s,a,b,path_loss_db
0,a,b,80
3,a,b,100
5,a,b,140
5.5,a,b,inf
7,a,b,85
0,a,c,110
8,a,c,70
"""


def scenario(engine: str, folder: Path, trace: str, **radio: Any) -> Any:
    (folder / "measured.csv").write_text(trace)
    propagation = {"model": "table", "file": "measured.csv", "interpolate": True}
    node = {"processes": ["udp_mesh"]}
    return parse_scenario(
        {
            "name": "measured",
            "engine": engine,
            "duration": "9s",
            "radio": {**radio, "propagation": propagation},
            "nodes": {"a": node, "b": {**node, **({"radio": {"tx_power": "26dBm"}} if radio else {})}, "c": node},
            "traffic": [
                {"from": "a", "to": "b", "topic": "t", "size": "200B", "rate": "50Hz", "reliability": "best_effort"}
            ],
            "expect": [{"reconnect": {"between": ["a", "b"]}, "max": "300ms"}],
        },
        name="measured.yaml",
        directory=folder,
    )


def states(lab: Lab, sender: str, receiver: str) -> list[tuple[float, dict[str, Any]]]:
    with Capture.open(lab.capture) as capture:
        rows = [
            ((record.t_ns - capture.t0_ns) / 1e9, record.payload)
            for record in capture.records({Kind.LINKS})
            if isinstance(record, JsonRecord)
        ]
    return [(t_s, row) for t_s, row in rows if (row["from"], row["to"]) == (sender, receiver)]


def test_strengths_follow_the_measured_path_losses(make_lab: MakeLab, tmp_path: Path, engine: str) -> None:
    lab = make_lab(scenario(engine, tmp_path, LOSSES, phy="802.11g-20MHz"))
    result = lab.run()
    assert not result.problems
    assert result.passed, result.report()
    [reconnect] = [entry for entry in result.summary["reconnects"] if set(entry["between"]) == {"a", "b"}]
    assert 6.9 <= reconnect["restored_at_s"] <= 7.2
    [stream] = result.summary["streams"]
    lost_from_s = 3 + (111 - 100) / 20  # until 111 dB half of the frames of a arrive, b's acknowledgements longer
    assert 50 * (lost_from_s - 0.5 + 2.0) < stream["delivered"] < 50 * (lost_from_s + 0.5 + 2.0)
    for t_s, row in states(lab, "a", "c"):
        if 0.2 < t_s < 8.0:
            assert row["rssi_dbm"] == pytest.approx(20 - 110 + 5 * t_s, abs=1.0), t_s
    assert [row["state"] for t_s, row in states(lab, "a", "b") if 0.2 < t_s < 6.9][-1] == "out_of_range"
    first_s, first = next((t_s, row) for t_s, row in states(lab, "b", "a") if 0.2 < t_s < 2.0)
    assert first["rssi_dbm"] == pytest.approx(26 - 80 - 20 / 3 * first_s, abs=1.0)


def test_loss_goes_from_row_to_row(make_lab: MakeLab, tmp_path: Path, engine: str) -> None:
    """From 0 % to 80 % within 8 s; back in range at 8.5 s, after half a second of nothing."""
    trace = "at_s,from,to,loss_percent,delay_ms\n0,a,b,0,1\n8,a,b,80,9\n8.001,a,b,100,\n8.5,a,b,0,1\n0,b,a,0,1\n"
    lab = make_lab(scenario(engine, tmp_path, trace))
    result = lab.run()
    assert not result.problems
    [stream] = result.summary["streams"]
    assert 240 + 25 - 60 < stream["delivered"] < 240 + 25 + 60  # 400 less 40 % on average, and the last half second
    flowing = [(t_s, row["impairment"]) for t_s, row in states(lab, "a", "b") if 0.2 < t_s < 8.0]
    assert len(flowing) >= 10
    for t_s, words in flowing:
        assert words["loss"]["loss_ratio"] == pytest.approx(0.1 * t_s, abs=0.02), t_s
        assert words["delay_s"] == pytest.approx(0.001 + 0.001 * t_s, abs=0.0002), t_s
    assert [entry["restored_at_s"] for entry in result.summary["reconnects"]] == [pytest.approx(8.5, abs=0.05)]
