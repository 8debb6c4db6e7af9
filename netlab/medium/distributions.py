"""Shapes of the delay's variation as sch_netem takes them: inverse distribution functions, sampled. Pure.

Theory. netem draws a uniform index into a table of the distribution's *inverse* cumulative function, in units of
jitter/8192 (NETEM_DIST_SCALE), so that value 8192 means "one jitter later than the mean". tc ships such tables as files
that small programs of iproute2 (netem/normal.c, pareto.c, paretonormal.c) generate; these are the same formulas in
closed form, equal to the shipped files within one unit (1/8192 of the jitter).
"""

from __future__ import annotations

import functools
import math
import statistics

from netlab.medium.impairments import Distribution

SCALE = 8192  # NETEM_DIST_SCALE, linux/pkt_sched.h
_TABLE_SIZE = 16384  # NETEM_DIST_MAX, the resolution of the generating formulas; every fourth value is kept
_STEP = 4
_PARETO_SHAPE = 3.0
_SHORT_MIN, _SHORT_MAX = -32768, 32767


@functools.lru_cache(maxsize=8)
def delay_values(distribution: Distribution) -> tuple[int, ...]:
    """Return 4096 values, ascending, in units of jitter/8192; each is equally likely.

    ``UNIFORM`` gives a straight line from -jitter to +jitter, which is what netem does without a table.
    """
    value = _VALUES[distribution]
    return tuple(value(position) for position in range(0, _TABLE_SIZE, _STEP))


def _uniform(position: int) -> int:
    # The middle of each of the 4096 steps, so that the mean is exactly zero.
    return round(SCALE * (2 * (position + _STEP / 2) / _TABLE_SIZE - 1))


def _normal(position: int) -> int:
    return _clamp(_normal_unclamped(position))


def _normal_unclamped(position: int) -> int:
    # The generator walks x upwards and keeps the last x that rounds to this position: the upper edge of its bin.
    return round(statistics.NormalDist().inv_cdf((position + 0.5) / _TABLE_SIZE) * SCALE)


def _pareto(position: int) -> int:
    # Shape 3 has mean 3/2 and, scaled by 4/3, about unit deviation.
    survival = (65536 - _STEP * position) / 65536
    return _clamp(round((survival ** (-1 / _PARETO_SHAPE) - 1.5) * (4 / 3) * SCALE))


def _paretonormal(position: int) -> int:
    return _clamp(math.trunc((_normal_unclamped(position) + 3 * _pareto(position)) / 4))


def _clamp(value: int) -> int:
    return max(_SHORT_MIN, min(_SHORT_MAX, value))


_VALUES = {
    Distribution.UNIFORM: _uniform,
    Distribution.NORMAL: _normal,
    Distribution.PARETO: _pareto,
    Distribution.PARETONORMAL: _paretonormal,
}
