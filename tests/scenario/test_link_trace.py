"""Measured links as a CSV file: what its columns mean, and which mistakes are named."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from netlab.errors import ScenarioError
from netlab.scenario import parse_scenario
from netlab.scenario.base import Problems
from netlab.scenario.link_trace import parse_link_trace
from netlab.timeline.paths import RadioWords


def test_a_trace_is_read_by_time_with_units_converted() -> None:
    trace = parse_link_trace(
        "t.csv", "# measured\nat_s,from,to,loss_percent,delay_ms,rate_mbit\n5,b,a,,2.5,\n1.5,a,b,10,,6\n"
    )
    first, second = trace.rows
    assert (first.at_s, first.sender, first.receiver, first.loss_ratio, first.rate_bps) == (1.5, "a", "b", 0.1, 6e6)
    assert (second.delay_s, second.loss_ratio, second.line) == (0.0025, None, 3)
    assert not trace.has_strengths


def test_a_row_of_two_ends_is_both_directions_and_columns_may_be_few_and_in_any_order() -> None:
    trace = parse_link_trace("t.csv", "a,b,path_loss_db,at_s\nx,y,91.5,2\nx,z,inf,1\n")
    assert [(row.at_s, row.sender, row.receiver, row.path_loss_db, row.line) for row in trace.rows] == [
        (1.0, "x", "z", math.inf, 3),
        (1.0, "z", "x", math.inf, 3),
        (2.0, "x", "y", 91.5, 2),
        (2.0, "y", "x", 91.5, 2),
    ]
    assert trace.has_strengths


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "t.csv: the file is empty; it needs columns such as at_s,from,to,loss_percent"),
        ("at_s,a,b,pathloss_db\n", "t.csv:1: unknown column 'pathloss_db'; did you mean 'path_loss_db'?"),
        ("#\nat_s,a,to,rssi_dbm\n", "t.csv:2: the columns must be at_s, then from and to (one direction) or a and b"),
        ("at_s,a,b,from,to,rssi_dbm\n", "t.csv:1: the columns must be at_s, then from and to (one direction) or a"),
        ("a,b,rssi_dbm\n", "t.csv:1: the columns must be at_s, then"),
        ("at_s,a,b\n", "t.csv:1: there is no value; add some of loss_percent, delay_ms, rate_mbit, path_loss_db,"),
        ("at_s,a,b,a,rssi_dbm\n", "t.csv:1: there are two columns a; remove one"),
        ("at_s,a,b,rssi_dbm,path_loss_db\n", "t.csv:1: path_loss_db and rssi_dbm say the same; remove one of"),
        ("at_s,a,b,rssi_dbm\n1,x,y\n", "t.csv:2: 3 cells; there must be 4"),
        ("at_s,a,b,rssi_dbm\n,x,y,-50\n", "t.csv:2: at_s is empty; give the time in seconds"),
        ("at_s,a,b,rssi_dbm\n1,x,y,70\n", "t.csv:2: rssi_dbm 70 is impossible; it must be -200 to 60, or -inf for out"),
        ("at_s,a,b,rssi_dbm\n1,x,y,inf\n", "t.csv:2: rssi_dbm inf is impossible"),
        ("at_s,a,b,path_loss_db\n1,x,y,-3\n", "t.csv:2: path_loss_db -3 is impossible; it must be 0 to 300, or inf"),
        ("at_s,a,b,path_loss_db\n1,x,y,nan\n", "t.csv:2: path_loss_db nan is impossible"),
        ("at_s,a,b,loss_percent\n1,x,y,101\n", "t.csv:2: loss_percent 101 is impossible; it must be 0 to 100"),
        ("at_s,a,b,delay_ms\n1,x,y,soon\n", "t.csv:2: delay_ms 'soon' is not a number; the column's name gives"),
        ("at_s,a,b,rate_mbit\n1,x,y,0\n", "t.csv:2: rate_mbit 0 is impossible; leave the cell empty, or give loss"),
    ],
)
def test_mistakes_are_named_by_file_and_line(text: str, expected: str) -> None:
    with pytest.raises(Problems) as caught:
        parse_link_trace("t.csv", text)
    [problem] = caught.value.problems
    assert problem.startswith(expected)


def table(tmp_path: Path, trace: str = "at_s,a,b,path_loss_db\n0,a,b,90\n", **keys: Any) -> Any:
    (tmp_path / "t.csv").write_text(trace)
    scenario: dict[str, Any] = {
        "duration": "9s",
        "nodes": {"a": {}, "b": {"radio": {"tx_power": "33dBm"}}, "c": {}},
        "radio": {"phy": "802.11g-20MHz", "propagation": {"model": "table", "file": "t.csv"}},
    }
    return parse_scenario(scenario | keys, name="s", directory=tmp_path)


def test_a_path_loss_leaves_what_is_heard_of_the_senders_power(tmp_path: Path) -> None:
    """20 dBm is everybody's power, 33 dBm is b's."""
    pairs = [{"between": ["a", "b"], "path_loss": "90dB"}, {"from": "c", "to": "b", "rssi": "-60dBm"}]
    propagation = {"model": "table", "pairs": pairs, "default": {"path_loss": "120dB"}}
    words = RadioWords(table(tmp_path, radio={"phy": "subt", "propagation": propagation}))

    def heard(hop: tuple[str, str]) -> float | None:
        found = words.get(hop)
        return None if found is None else found.rssi_dbm

    expected = {("a", "b"): -70.0, ("b", "a"): -57.0, ("c", "b"): -60.0, ("b", "c"): -87.0, ("a", "c"): -100.0}
    assert {hop: heard(hop) for hop in expected} == expected


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"radio": {"propagation": {"model": "table", "file": "t.csv"}}}, "radio: path losses and strengths over time"),
        (
            {"radio": {"driver": "hwsim", "propagation": {"model": "table", "file": "t.csv"}}},
            "radio: path losses and strengths over time need a phy; remove driver: hwsim and add phy: 802.11g-20MHz",
        ),
        (
            {"radio": {"phy": "subt", "propagation": {"model": "table", "interpolate": True}}},
            "radio.propagation: interpolate is about the rows of a file, and there is none; add file or remove it",
        ),
        (
            {"nodes": {"a": {"radio": {"antenna": "omni"}}, "b": {}}},
            "nodes.a.radio: a radio of its own means nothing here",
        ),
        (
            {"events": [{"at": "1s", "link": {"between": ["a", "b"], "rssi": "-50dBm"}}]},
            "events[0].link.rssi: rssi is what t.csv says; remove it",
        ),
    ],
)
def test_words_that_mean_nothing_beside_a_trace(tmp_path: Path, keys: dict[str, Any], expected: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        table(tmp_path, **({"nodes": {"a": {}, "b": {}}} | keys))
    assert [problem for problem in caught.value.problems if f": {expected}" in problem], caught.value.problems
    assert len(caught.value.problems) == 1


def test_one_strength_per_pair() -> None:
    pair = {"between": ["a", "b"], "path_loss": "90dB", "rssi": "-50dBm"}
    radio = {"phy": "subt", "propagation": {"model": "table", "pairs": [pair]}}
    with pytest.raises(ScenarioError, match=r"pairs\[0\]: path_loss and rssi say the same; remove one"):
        parse_scenario({"duration": "1s", "nodes": {"a": {}, "b": {}}, "radio": radio})
