"""Measured traces tick by tick: what the engine is told, and when it is told nothing."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from netlab.engines.base import Engine, LabPlan, Pair
from netlab.engines.plan import compile_plan
from netlab.lab.links import Links
from netlab.lab.measured import MeasuredWaves, WordsBetweenRows
from netlab.medium.impairments import Impairment, RandomLoss
from netlab.scenario import Scenario, parse_scenario

A, B, C = range(3)


class Notes:
    """An engine that only notes what it is told."""

    def __init__(self) -> None:
        self.pairs: list[dict[Pair, Impairment | None]] = []

    def set_pairs(self, changes: dict[Pair, Impairment | None]) -> None:
        self.pairs.append(changes)

    def set_rssi(self, segment: str, rssi_dbm: np.ndarray) -> None:
        pass


def lab(folder: Path, trace: str, **propagation: Any) -> tuple[Scenario, LabPlan, Links, Notes]:
    (folder / "t.csv").write_text(trace)
    phy = {"phy": "802.11g-20MHz"} if "_db" in trace else {}
    power = {"radio": {"tx_power": "30dBm"}} if "path_loss_db" in trace else {}
    scenario = parse_scenario(
        {
            "duration": "60s",
            "radio": {**phy, "propagation": {"model": "table", "file": "t.csv", "interpolate": True, **propagation}},
            "nodes": {"a": {}, "b": power, "c": {}},
        },
        directory=folder,
    )
    plan, engine = compile_plan(scenario), Notes()
    return scenario, plan, Links(plan, cast(Engine, engine)), engine


def test_strengths_come_from_path_losses_powers_and_what_the_table_says_for_good(tmp_path: Path) -> None:
    pairs = [{"between": ["b", "c"], "rssi": "-61dBm"}, {"from": "a", "to": "b", "rssi": "-44dBm"}]
    trace = "at_s,a,b,path_loss_db\n2,a,b,80\n4,a,b,90\n2,a,c,70\n"
    scenario, plan, links, _ = lab(tmp_path, trace, pairs=pairs)
    waves = MeasuredWaves(scenario, plan, links)
    waves.update(1.0)  # before the first rows
    signals = {pair: links.signals.rssi_dbm(pair) for pair in ((A, B), (B, A), (A, C), (B, C), (C, B))}
    assert signals == {(A, B): -44, (B, A): -math.inf, (A, C): -math.inf, (B, C): -61, (C, B): -61}
    waves.update(3.0)
    assert (links.signals.rssi_dbm((A, B)), links.signals.rssi_dbm((B, A))) == (20 - 85, 30 - 85)
    assert links.signals.rssi_dbm((B, C)) == -61


def test_a_loss_of_everything_is_no_contact_however_strong(tmp_path: Path) -> None:
    scenario, plan, links, _ = lab(tmp_path, "at_s,a,b,rssi_dbm,loss_percent\n0,a,b,-50,0\n0,a,c,-60,100\n")
    MeasuredWaves(scenario, plan, links).update(0.0)
    heard = links.heard(plan.segments[0])
    assert (heard[A, B], heard[B, A], heard[A, C], heard[B, C]) == (True, True, False, False)
    links.set_pairs({(A, C): Impairment()})
    assert links.heard(plan.segments[0])[A, C]


def test_words_go_from_row_to_row_and_only_news_are_told(tmp_path: Path) -> None:
    trace = "at_s,from,to,loss_percent,delay_ms\n0,a,b,0,10\n10,a,b,50,\n20,a,b,50,30\n0,a,c,5,\n"
    scenario, plan, links, engine = lab(tmp_path, trace)
    words = WordsBetweenRows(scenario, plan, links)
    words.update(5.0)
    [told] = engine.pairs
    assert told[A, B] == Impairment(loss=RandomLoss(0.25), delay_s=pytest.approx(0.015))
    assert told[A, C] == Impairment(loss=RandomLoss(0.05))
    words.update(5.0)
    assert len(engine.pairs) == 1
    words.update(10.0)
    assert set(engine.pairs[1]) == {(A, B)}
    now = links.impairment((A, B))
    assert now is not None
    links.set_pairs({(A, B): replace(now, loss=None)})  # a link event
    words.update(15.0)
    assert engine.pairs[-1][A, B] == Impairment(delay_s=pytest.approx(0.025)), "the loss stays, and so does the event"


def test_a_pair_out_of_range_is_left_to_its_next_row(tmp_path: Path) -> None:
    scenario, plan, links, engine = lab(tmp_path, "at_s,from,to,loss_percent\n0,a,b,100\n10,a,b,20\n20,a,b,40\n")
    words = WordsBetweenRows(scenario, plan, links)
    words.update(5.0)
    assert engine.pairs == []
    words.update(12.0)  # before the timeline has let the row take effect
    assert engine.pairs == []
