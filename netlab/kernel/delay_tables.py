"""Delay distribution tables as sch_netem takes them, encoded; values of :mod:`netlab.medium.distributions`. Pure."""

from __future__ import annotations

import array
import functools

from netlab.medium.distributions import delay_values
from netlab.medium.impairments import Distribution


@functools.lru_cache(maxsize=8)
def delay_table(distribution: Distribution) -> bytes:
    """Return TCA_NETEM_DELAY_DIST: 4096 16-bit values in the machine's byte order.

    ``UNIFORM`` gives a straight line from -jitter to +jitter, which is what netem does without a table: needed where an
    earlier table has to be replaced, because a change without a table keeps the old one.
    """
    return array.array("h", delay_values(distribution)).tobytes()
