"""Whether what was observed is what must be. Pure.

The bound of a figure is four of its standard errors. At 50,000 frames that is less than the 99 % interval at 20,000
frames (2.576 standard errors of those), and a right medium is outside of it once in 16,000 figures instead of once in
a hundred: a table of some hundred figures would otherwise never be free of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from agreement_rig import expectations, tracks
from agreement_rig.cells import Cell
from agreement_rig.chains import Expected
from agreement_rig.references import Delays, Reference, judged_part
from agreement_rig.shapes import quantile_of
from agreement_rig.tracks import Track, Tracks
from netlab.medium.impairments import Distribution, Impairment

KERNEL = "netem"
ERRORS = 4.0
Z_99 = 2.576
QUANTILES = (0.01, 0.05, 0.10, 0.25, 0.50, 0.75, 0.90, 0.95, 0.99)
#: What timers, stamps and reading the clock add in virtual time; measured: 5 microseconds.
TIMER_S = 30e-6
#: For sampled figures: a departure that falls together with an arrival goes either way.
GRAIN_RATIO = 0.0005
#: The same for a short series: the fate of this many frames.
GRAIN_FRAMES = 2
RATE_TOLERANCE = 0.001
#: What the agreement promises of the bounds of all quantiles.
PROMISED_S = 0.0002


class Kind(Enum):
    """What a figure is."""

    RATIO = "ratio"
    DELAY = "delay"
    RATE = "rate"
    CORRELATION = "correlation"


@dataclass(frozen=True, slots=True)
class Verdict:
    """One figure of one candidate; ``error`` is its standard error. For delays: seconds at the worst quantile."""

    expected: float
    value: float
    bound: float
    error: float = 0.0

    @property
    def excess(self) -> float:
        """The deviation in bounds."""
        deviation = abs(self.value - self.expected)
        if self.bound:
            return deviation / self.bound
        return math.inf if deviation else 0.0

    @property
    def passed(self) -> bool:
        """Whether the figure is what it must be."""
        return self.excess <= 1


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of one phase, as each candidate has it.

    For delays only: ``shares`` names the worst quantile of each candidate, ``marks`` are p1, p50 and p99 as they must
    be, ``widest_s`` is the largest bound of all quantiles.
    """

    phase: int
    name: str
    receiver: str
    kind: Kind
    by_theory: bool
    verdicts: Mapping[str, Verdict]
    shares: Mapping[str, float] = field(default_factory=dict)
    marks: tuple[float, ...] = ()
    widest_s: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether every candidate passed."""
        return all(verdict.passed for verdict in self.verdicts.values())


def judge(cell: Cell, phase: int, must: Reference, candidates: Mapping[str, Tracks]) -> list[Figure]:
    """Every figure of one phase of a cell, for every candidate (by name; ``netem`` is the kernel)."""
    parts = {name: judged_part(cell, tracks_[phase]) for name, tracks_ in candidates.items()}
    figures = _ratios(cell, phase, must, parts)
    for receiver in cell.judged:
        label, imp = expectations.label(cell, receiver), cell.phases[phase][receiver]
        received = {name: part[receiver] for name, part in parts.items()}
        figures.append(_delay(phase, label, must.delays[label], received))
        if expectations.saturated(cell, imp) and imp.rate_bps is not None:
            figures.append(_rate(phase, label, imp.rate_bps, cell.size_bytes, received))
        if imp.delay_correlation and imp.distribution is Distribution.NORMAL:
            figures.append(_correlation(phase, label, imp, received))
    return figures


def _ratios(cell: Cell, phase: int, must: Reference, parts: Mapping[str, Sequence[Track]]) -> list[Figure]:
    found = {name: expectations.series(cell, cell.phases[phase], part) for name, part in parts.items()}
    figures = []
    for key, expected in must.figures.items():
        verdicts = {
            name: _ratio(
                must.netem_only.get(key, expected) if name == KERNEL else expected, series[key], key in must.by_theory
            )
            for name, series in found.items()
        }
        figures.append(Figure(phase, key[0], key[1], Kind.RATIO, key in must.by_theory, verdicts))
    return figures


def _ratio(expected: Expected, series: Sequence[int], by_theory: bool) -> Verdict:
    error = math.sqrt(expected.variance / len(series))
    bound = ERRORS * error + (0.0 if by_theory else max(GRAIN_RATIO, GRAIN_FRAMES / len(series)))
    return Verdict(expected.mean, sum(series) / len(series), bound, error)


def quantile_bounds(delays: Delays, share: float, count: int) -> tuple[float, float]:
    """How far below and above its q-quantile the one of ``count`` delays may lie, in seconds."""
    width = ERRORS * math.sqrt(delays.variance(share) / count)
    middle = delays.quantile(share)
    below, above = delays.quantile(max(0.0, share - width)), delays.quantile(min(1.0, share + width))
    return middle - below + TIMER_S, above - middle + TIMER_S


def _delay(phase: int, label: str, must: Delays, received: Mapping[str, Track]) -> Figure:
    verdicts, shares = {}, {}
    bounds: dict[tuple[float, int], tuple[float, float]] = {}
    for name, track in received.items():
        observed = quantile_of(sorted(track.delays_s) or [math.inf])
        count = max(1, round(len(track.delays_s), -3))  # rounded: one calculation for all candidates
        judged = []
        for share in QUANTILES:
            if (share, count) not in bounds:
                bounds[share, count] = quantile_bounds(must, share, count)
            expected, value = must.quantile(share), observed(share)
            judged.append((Verdict(expected, value, bounds[share, count][value > expected]), share))
        verdicts[name], shares[name] = max(judged, key=lambda one: one[0].excess)
    widest_s = max(map(max, bounds.values()))
    marks = tuple(map(must.quantile, (0.01, 0.50, 0.99)))
    return Figure(phase, "delay", label, Kind.DELAY, must.by_theory, verdicts, shares, marks, widest_s)


def _rate(phase: int, label: str, rate_bps: float, size_bytes: int, received: Mapping[str, Track]) -> Figure:
    bound = RATE_TOLERANCE * rate_bps
    verdicts = {name: Verdict(rate_bps, tracks.rate_bps(track, size_bytes), bound) for name, track in received.items()}
    return Figure(phase, "rate", label, Kind.RATE, True, verdicts)


def _correlation(phase: int, label: str, imp: Impairment, received: Mapping[str, Track]) -> Figure:
    """A known deviation: the kernel's delays hardly correlate (see netlab/medium/delay.py)."""
    verdicts = {}
    for name, track in received.items():
        expected = 0.0 if name == KERNEL else imp.delay_correlation
        error = 1 / math.sqrt(track.frames)
        verdicts[name] = Verdict(expected, tracks.lag_one(track), ERRORS * error, error)
    return Figure(phase, "correlation of neighbours", label, Kind.CORRELATION, True, verdicts)
