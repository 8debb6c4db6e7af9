"""Quantiles of delays: by formula where the impairment allows one, else of a large sample. Pure.

The formulas are those of tc-netem(8) and of the programs in iproute2 that generate its tables (netem/normal.c,
pareto.c, paretonormal.c), in closed form and written without :mod:`netlab.medium.distributions`, which they judge.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence

from netlab.medium.impairments import Distribution, Impairment

Quantile = Callable[[float], float]  # share 0..1 -> delay in seconds

_TABLE_MAX = 32767 / 8192  # a table's 16-bit values, in units of the jitter


def quantile_of(ascending: Sequence[float]) -> Quantile:
    """Quantiles of a sample."""
    return lambda share: ascending[min(len(ascending) - 1, int(share * len(ascending)))]


def formula(impairment: Impairment, size_bytes: int, at_once_ratio: float, spacing_s: float) -> Quantile | None:
    """Quantiles of the delay as set; None where queueing and jitter mix.

    Args:
        impairment: Of one direction.
        size_bytes: Of the frames.
        at_once_ratio: How many of them are not delayed at all (reordering).
        spacing_s: Between two frames.
    """
    line_s = size_bytes * 8 / impairment.rate_bps if impairment.rate_bps else 0.0
    if line_s and (impairment.jitter_s or at_once_ratio or line_s >= spacing_s):
        return None
    shape = _SHAPES[impairment.distribution]

    def quantile(share: float) -> float:
        if share < at_once_ratio:
            return 0.0
        rest = (share - at_once_ratio) / (1 - at_once_ratio)
        varying = impairment.jitter_s * shape(rest) if impairment.jitter_s else 0.0
        return max(0.0, impairment.delay_s + varying) + line_s

    return quantile


def _clamped(value: float) -> float:
    return max(-_TABLE_MAX, min(_TABLE_MAX, value))


def _uniform(share: float) -> float:
    return 2 * share - 1


def _normal(share: float) -> float:
    return _clamped(statistics.NormalDist().inv_cdf(min(max(share, 1e-9), 1 - 1e-9)))


def _pareto(share: float) -> float:
    return _clamped((max(1 - share, 1e-9) ** (-1 / 3) - 1.5) * 4 / 3)


def _paretonormal(share: float) -> float:
    return _clamped((_normal(share) + 3 * _pareto(share)) / 4)


_SHAPES: dict[Distribution, Quantile] = {
    Distribution.UNIFORM: _uniform,
    Distribution.NORMAL: _normal,
    Distribution.PARETO: _pareto,
    Distribution.PARETONORMAL: _paretonormal,
}
