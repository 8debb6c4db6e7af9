"""What one direction of a link does to frames: values only, in tc-netem's words and meanings.

An :class:`Impairment` belongs to a directed pair of ports. It is compiled to tc by the ``netem`` engine and interpreted
by :mod:`netlab.medium.pair` for ``air`` and ``sim``. Ratios are 0..1, times seconds, rates bits per second.
Source of the meanings: tc-netem(8) and the kernel's net/sched/sch_netem.c.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Distribution(StrEnum):
    """Shape of the delay's variation; ``UNIFORM`` is netem's default without a table."""

    UNIFORM = "uniform"
    NORMAL = "normal"
    PARETO = "pareto"
    PARETONORMAL = "paretonormal"


@dataclass(frozen=True, slots=True)
class RandomLoss:
    """Independent (or first-order correlated) loss of ``loss_ratio`` of the frames."""

    loss_ratio: float
    correlation: float = 0.0


@dataclass(frozen=True, slots=True)
class GilbertElliottLoss:
    """netem's ``loss gemodel p r 1-h 1-k``: ``p`` good->bad, ``r`` bad->good, loss in the bad and in the good state."""

    p: float
    r: float
    loss_in_bad: float = 1.0
    loss_in_good: float = 0.0


@dataclass(frozen=True, slots=True)
class FourStateLoss:
    """netem's ``loss state p13 p31 p32 p23 p14``: transition probabilities of the four-state Markov chain."""

    p13: float
    p31: float
    p32: float
    p23: float
    p14: float


@dataclass(frozen=True, slots=True)
class PeriodicLoss:
    """Every ``every``-th frame is lost, the first loss being frame number ``offset`` (counted from 0)."""

    every: int
    offset: int = 0


@dataclass(frozen=True, slots=True)
class TraceLoss:
    """Frame k is lost where ``pattern[k % len(pattern)]`` is true."""

    pattern: tuple[bool, ...]


LossModel = RandomLoss | GilbertElliottLoss | FourStateLoss | PeriodicLoss | TraceLoss


@dataclass(frozen=True, slots=True)
class Impairment:
    """One direction of one pair. The default is a perfect wire with netem's queue limit of 1000 frames.

    ``limit_packets`` and ``limit_bytes`` count what waits for its departure, delayed frames included; the one that is
    None does not limit. ``reorder_ratio`` of every ``reorder_gap``-th frame leaves at once, ahead of the delayed ones.
    ``rssi_dbm`` is how strongly an 802.11 receiver hears the sender (None: the driver's default); nobody else uses it.
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    delay_correlation: float = 0.0
    distribution: Distribution = Distribution.UNIFORM
    loss: LossModel | None = None
    duplicate_ratio: float = 0.0
    duplicate_correlation: float = 0.0
    reorder_ratio: float = 0.0
    reorder_correlation: float = 0.0
    reorder_gap: int = 1
    corrupt_ratio: float = 0.0
    corrupt_correlation: float = 0.0
    rate_bps: float | None = None
    limit_packets: int | None = 1000
    limit_bytes: int | None = None
    rssi_dbm: float | None = None


PERFECT = Impairment()
