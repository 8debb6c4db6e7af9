"""Measured traces in a running lab: strengths over time for the engine, and words that go from one row to the next.

Rows themselves are entries of the timeline. What lies between them, where a scenario interpolates, happens here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from netlab.engines.base import LabPlan, Pair
from netlab.lab.links import Links
from netlab.medium.impairments import Impairment, LossModel, RandomLoss
from netlab.medium.segments import DEFAULT_RSSI_DBM, Segment, SegmentKind
from netlab.scenario.link_trace import TraceRow
from netlab.scenario.model import Scenario
from netlab.scenario.radio import Propagation
from netlab.world.geometry import Floats
from netlab.world.measured import MeasuredStrengths, Sample, Series


class MeasuredWaves:
    """The signal strengths that a scenario's file gives."""

    def __init__(self, scenario: Scenario, plan: LabPlan, links: Links) -> None:
        rows = _rows(scenario)
        [segment] = (segment for segment in plan.segments if segment.channel is not None)
        self._segment = segment.name
        self._links = links
        place = {plan.ports[port].node: place for place, port in enumerate(segment.ports)}
        samples: dict[Pair, list[Sample]] = {}
        for row in rows:
            if (rssi_dbm := _rssi_dbm(scenario, row)) is not None:
                samples.setdefault((place[row.sender], place[row.receiver]), []).append((row.at_s, rssi_dbm))
        constant_dbm = _constant_dbm(scenario, plan, segment, samples)
        self._strengths = MeasuredStrengths(constant_dbm, samples, interpolate=_propagation(scenario).interpolate)

    def update(self, at_s: float) -> None:
        """Let a scenario time take effect.

        Raises:
            LabError: The engine is gone.
        """
        self._links.set_rssi(self._segment, self._strengths.rssi_dbm(at_s))


class WordsBetweenRows:
    """Loss, delay and rate on their way from one row of the file to the next, of pairs that are in range."""

    def __init__(self, scenario: Scenario, plan: LabPlan, links: Links) -> None:
        rows = _rows(scenario)
        self._links = links
        [segment] = (segment for segment in plan.segments if segment.kind is SegmentKind.RADIO)
        port = {plan.ports[index].node: index for index in segment.ports}
        self._flows = [_Flow(name, samples) for name in _WORDS if (samples := _samples(rows, port, name))]

    def update(self, at_s: float) -> None:
        """Let a scenario time take effect.

        Raises:
            LabError: The engine is gone.
        """
        changes: dict[Pair, Impairment | None] = {}
        for flow in self._flows:
            for pair, word in flow.news(at_s):
                now = changes.get(pair) or self._links.impairment(pair)
                if now is not None:
                    changes[pair] = replace(now, **word)
        if changes:
            self._links.set_pairs(changes)


class _Flow:
    """One word of all pairs that have it. What has not changed is not told again, so that events may change it."""

    def __init__(self, name: str, samples: Mapping[Pair, Sequence[Sample]]) -> None:
        self._word = _WORDS[name]
        self._pairs = list(samples)
        self._series = Series(list(samples.values()), interpolate=True)
        self._told = np.full(len(self._pairs), np.nan)

    def news(self, at_s: float) -> Iterator[tuple[Pair, dict[str, Any]]]:
        values = self._series.at(at_s)
        changed = np.isfinite(values) & (values != self._told)
        self._told = values
        for index in np.flatnonzero(changed).tolist():
            yield self._pairs[index], self._word(float(values[index]))


def _propagation(scenario: Scenario) -> Propagation:
    assert scenario.radio is not None
    return scenario.radio.propagation


def _rows(scenario: Scenario) -> Sequence[TraceRow]:
    trace = _propagation(scenario).file
    assert trace is not None
    return trace.rows


def _loss(ratio: float) -> dict[str, Any]:
    loss: LossModel | None = RandomLoss(ratio) if ratio > 0.0 else None
    return {"loss": loss}


_Word = Callable[[float], dict[str, Any]]
_WORDS: Mapping[str, _Word] = {
    "loss_ratio": _loss,
    "delay_s": lambda value: {"delay_s": value},
    "rate_bps": lambda value: {"rate_bps": value},
}


def _samples(rows: Sequence[TraceRow], port: Mapping[str, int], name: str) -> dict[Pair, list[Sample]]:
    """A word's values by pair; a loss of everything, out of range, is infinite, which nothing leads to or from."""
    samples: dict[Pair, list[Sample]] = {}
    for row in rows:
        if (value := getattr(row, name)) is not None:
            out_of_range = name == "loss_ratio" and value == 1.0
            own = samples.setdefault((port[row.sender], port[row.receiver]), [])
            own.append((row.at_s, np.inf if out_of_range else value))
    return samples


def _rssi_dbm(scenario: Scenario, row: TraceRow) -> float | None:
    if row.path_loss_db is None:
        return row.rssi_dbm
    return scenario.radios(row.sender)[0].tx_power_dbm - row.path_loss_db


def _constant_dbm(scenario: Scenario, plan: LabPlan, segment: Segment, measured: Collection[Pair]) -> Floats:
    """What the scenario says of pairs for good; of ``measured`` ones (places), what holds before their first row."""
    propagation = _propagation(scenario)
    named = {hop for pair in propagation.pairs for hop in pair.directions}
    strengths = np.full((len(segment.ports), len(segment.ports)), -np.inf)
    for place in product(range(len(segment.ports)), repeat=2):
        sender, receiver = (segment.ports[index] for index in place)
        words = segment.pairs.get((sender, receiver))
        told = propagation.default is not None or (plan.ports[sender].node, plan.ports[receiver].node) in named
        if words is not None and (told or place not in measured):
            strengths[place] = DEFAULT_RSSI_DBM if words.rssi_dbm is None else words.rssi_dbm
    return strengths
