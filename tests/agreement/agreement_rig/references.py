"""What must come of one phase of a cell: by theory, else by samples of the pure medium. Pure."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from agreement_rig import expectations
from agreement_rig.cells import Cell
from agreement_rig.chains import Expected
from agreement_rig.expectations import Key
from agreement_rig.shapes import Quantile, quantile_of
from agreement_rig.tracks import Track, Tracks
from netlab.medium.impairments import Impairment

#: Long against every correlation here (a Gilbert chain of p 1 %, r 25 % forgets within 4 frames).
BATCH = 200


@dataclass(frozen=True, slots=True)
class Delays:
    """Quantiles of the delay, and V of "the delay is at most its q-quantile" (see :mod:`agreement_rig.chains`)."""

    quantile: Quantile
    variance: Callable[[float], float]
    by_theory: bool


@dataclass(frozen=True, slots=True)
class Reference:
    """``netem_only`` overrides ``figures`` for the kernel, where it differs for a known reason."""

    figures: dict[Key, Expected]
    by_theory: frozenset[Key]
    netem_only: dict[Key, Expected]
    delays: dict[str, Delays]  # by receiver


def needs_samples(cell: Cell) -> bool:
    """Whether some figure of the cell is beyond theory."""
    for imps in cell.phases:
        nothing = [Track(1) for _ in range(cell.receivers)]
        if expectations.series(cell, imps, nothing).keys() - expectations.theory(cell, imps).keys():
            return True
        if any(expectations.quantile_formula(cell, imps[receiver]) is None for receiver in cell.judged):
            return True
    return False


def reference(cell: Cell, phase: int, samples: Sequence[Tracks]) -> Reference:
    """Put together what must be; ``samples`` come from other seeds than what is judged, and may be few or none.

    Raises:
        ValueError: Theory does not suffice and there is no sample.
    """
    imps = cell.phases[phase]
    parts = [judged_part(cell, sample[phase]) for sample in samples]
    nothing = [Track(1) for _ in range(cell.receivers)]
    known = expectations.theory(cell, imps)
    wanted = expectations.series(cell, imps, nothing)
    beyond = wanted.keys() - known.keys()
    found = [expectations.series(cell, imps, part) for part in parts] if beyond else []
    certain = not any(is_random(imps[receiver]) for receiver in cell.judged)
    figures = {
        key: sampled([one[key] for one in found], certain=certain) if key in beyond else known[key] for key in wanted
    }
    delays = {
        expectations.label(cell, receiver): _delays(cell, imps[receiver], [part[receiver] for part in parts])
        for receiver in cell.judged
    }
    return Reference(figures, frozenset(known), expectations.restarted(cell, imps), delays)


def judged_part(cell: Cell, received: Sequence[Track]) -> list[Track]:
    """Without the frames that are not judged."""
    return [track.without_first(cell.skip) for track in received]


def _delays(cell: Cell, imp: Impairment, sample: Sequence[Track]) -> Delays:
    formula = expectations.quantile_formula(cell, imp)
    if formula is not None:
        return Delays(formula, delay_variance(imp), True)
    if not sample:
        raise ValueError(f"{cell.name}: the delays are beyond theory and there is no sample")
    in_order = [delay_s for track in sample for delay_s in track.delays_s]
    quantile = quantile_of(sorted(in_order))

    def variance(share: float) -> float:
        limit_s = quantile(share)
        if not is_random(imp):
            return 0.0
        return sampled([[float(delay_s <= limit_s) for delay_s in track.delays_s] for track in sample]).variance

    return Delays(quantile, variance, False)


def delay_variance(imp: Impairment) -> Callable[[float], float]:
    """V of "the delay is at most its q-quantile", an upper bound where delays are correlated.

    For a Gaussian process with the correlation c of neighbours, this indicator's correlation k frames apart is at most
    c^k, which makes V at most (1 + c) / (1 - c) times that of independent delays.
    """
    factor = (1 + imp.delay_correlation) / (1 - imp.delay_correlation)
    return lambda share: share * (1 - share) * factor


def is_random(imp: Impairment) -> bool:
    """Whether chance has any part in what it does."""
    ratios = imp.jitter_s, imp.duplicate_ratio, imp.reorder_ratio, imp.corrupt_ratio
    return imp.loss is not None or any(ratios)


def sampled(samples: Sequence[Sequence[float]], *, certain: bool = False) -> Expected:
    """Mean and long-run variance of a series by the means of batches; the sample's own error is part of V."""
    mean = statistics.fmean(map(statistics.fmean, samples))
    if certain:
        return Expected(mean, 0.0)
    batches = [
        statistics.fmean(values[at : at + BATCH])
        for values in samples
        for at in range(0, len(values) - BATCH + 1, BATCH)
    ]
    return Expected(mean, statistics.pvariance(batches) * BATCH * (1 + 1 / len(samples)))
