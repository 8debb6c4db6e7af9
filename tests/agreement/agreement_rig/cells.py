"""What is compared: one cell is one sender, one or three receivers, and what the medium does to frames in each phase.

Times are chosen off the grid of the sender's ticks (1 ms) where a queue fills, so that no departure falls together with
an arrival; ratios are chosen away from the quantiles that are compared, and jitters so small that a quantile's
statistical error stays below the 0.2 ms that the agreement promises (tests hold both).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from netlab.medium.impairments import (
    PERFECT,
    Distribution,
    FourStateLoss,
    GilbertElliottLoss,
    Impairment,
    RandomLoss,
)

TICK_S = 0.001
#: 4 standard errors at this many frames are narrower than the 99 % interval of 20,000 frames (2.576 standard errors).
MANY = 50_000
#: Enough where a figure is exact, or is a quantile.
SOME = 20_000
FRAME_BYTES = 100
LARGE_BYTES = 1250
RECEIVERS = 3


class Reach(Enum):
    """How the frames are addressed, and over what."""

    WIRE = "unicast, wire"
    RADIO = "unicast, radio"
    BROADCAST = "broadcast, radio"


@dataclass(frozen=True, slots=True)
class Cell:
    """One line of the table.

    ``phases[p][r]`` is the impairment towards receiver ``r`` in phase ``p``; ``frames`` are sent per phase, one a tick.
    The first ``skip`` of each phase are not judged (a queue fills). Every ``changed_every`` frames the delay changes by
    ``CHANGE_S``, up and down, as for a robot that moves.
    """

    name: str
    phases: tuple[tuple[Impairment, ...], ...]
    frames: int
    reach: Reach = Reach.WIRE
    size_bytes: int = FRAME_BYTES
    skip: int = 0
    changed_every: int = 0

    @property
    def ticks(self) -> int:
        """Frames that are sent in all phases."""
        return self.frames * len(self.phases)

    @property
    def receivers(self) -> int:
        """Ports that may hear the frames."""
        return 1 if self.reach is Reach.WIRE else RECEIVERS

    @property
    def addressee(self) -> int | None:
        """The receiver that unicast frames are for; None: all."""
        return {Reach.WIRE: 0, Reach.RADIO: 1, Reach.BROADCAST: None}[self.reach]

    @property
    def judged(self) -> tuple[int, ...]:
        """Receivers whose frames are judged; unicast frames reach nobody else."""
        return tuple(range(self.receivers)) if self.addressee is None else (self.addressee,)


CHANGE_S = 0.00001


def changed(impairment: Impairment, generation: int) -> Impairment:
    """The impairment as sent at the ``generation``-th repetition."""
    return replace(impairment, delay_s=impairment.delay_s + CHANGE_S * (generation % 2))


def _cell(
    name: str, *phases: Impairment, frames: int, size_bytes: int = FRAME_BYTES, skip: int = 0, changed_every: int = 0
) -> Cell:
    each = tuple((phase,) for phase in phases)
    return Cell(name, each, frames + skip, size_bytes=size_bytes, skip=skip, changed_every=changed_every)


def _radio(name: str, reach: Reach, receivers: tuple[Impairment, ...], frames: int) -> Cell:
    return Cell(name, (receivers,), frames, reach)


_MS = 0.001
_WIRE = Impairment(delay_s=5 * _MS)
_LOSSY = replace(_WIRE, loss=RandomLoss(0.10))
_GILBERT = GilbertElliottLoss(p=0.01, r=0.25)
_ELLIOTT = GilbertElliottLoss(p=0.02, r=0.40, loss_in_bad=0.80, loss_in_good=0.01)
_NORMAL = Impairment(delay_s=20 * _MS, jitter_s=1.2 * _MS, distribution=Distribution.NORMAL)
_UNIFORM = Impairment(delay_s=20 * _MS, jitter_s=4 * _MS)
_HEAVY = Impairment(delay_s=20 * _MS, jitter_s=0.5 * _MS, distribution=Distribution.PARETO)
_BUSY = Impairment(delay_s=5.1 * _MS, rate_bps=8.77e6, limit_packets=60)

_DELAYS = (
    _cell("delay 20 ms", Impairment(delay_s=20 * _MS), frames=SOME),
    _cell("jitter 20 ± 4 ms, uniform", _UNIFORM, frames=SOME),
    _cell("jitter 20 ± 1.2 ms, normal", _NORMAL, frames=SOME),
    _cell("jitter 20 ± 0.5 ms, pareto", _HEAVY, frames=SOME),
    _cell("jitter 20 ± 0.5 ms, paretonormal", replace(_HEAVY, distribution=Distribution.PARETONORMAL), frames=SOME),
    _cell("jitter beyond the delay, 1 ± 3 ms", replace(_UNIFORM, delay_s=1 * _MS, jitter_s=3 * _MS), frames=SOME),
    _cell(
        "jitter 20 ± 1 ms, normal, correlation 50 %",
        replace(_NORMAL, jitter_s=1 * _MS, delay_correlation=0.5),
        frames=MANY,
    ),
)
_LOSSES = (
    _cell("loss 1 %", replace(_WIRE, loss=RandomLoss(0.01)), frames=MANY),
    _cell("loss 10 %", _LOSSY, frames=MANY),
    _cell("loss 20 %, correlation 25 %", replace(_WIRE, loss=RandomLoss(0.20, correlation=0.25)), frames=MANY),
    _cell("Gilbert loss, p 1 %, r 25 %", replace(_WIRE, loss=_GILBERT), frames=MANY),
    _cell("Gilbert-Elliott loss, p 2 %, r 40 %, 80 % and 1 %", replace(_WIRE, loss=_ELLIOTT), frames=MANY),
    _cell("four-state loss", replace(_WIRE, loss=FourStateLoss(0.02, 0.30, 0.20, 0.40, 0.01)), frames=MANY),
)
_QUEUES = (
    _cell("rate 20 Mbit/s, half used", replace(_WIRE, rate_bps=20e6), frames=SOME, size_bytes=LARGE_BYTES),
    _cell("rate 8.77 Mbit/s, 10 offered, limit 60", _BUSY, frames=SOME, size_bytes=LARGE_BYTES, skip=2000),
    _cell(
        "rate 12.5 Mbit/s, 10 offered, jitter 5 ± 0.5 ms",
        Impairment(delay_s=5 * _MS, jitter_s=0.5 * _MS, distribution=Distribution.NORMAL, rate_bps=12.5e6),
        frames=SOME,
        size_bytes=LARGE_BYTES,
    ),
    _cell("limit 20, delay 50.3 ms", Impairment(delay_s=50.3 * _MS, limit_packets=20), frames=SOME),
    _cell(
        "limit 20, delay 30.3 ms, loss 20 %",
        Impairment(delay_s=30.3 * _MS, limit_packets=20, loss=RandomLoss(0.20)),
        frames=MANY,
    ),
)
_OTHERS = (
    _cell("duplicate 5 %", replace(_WIRE, duplicate_ratio=0.05), frames=MANY),
    _cell("duplicate 10 %, loss 10 %", replace(_LOSSY, duplicate_ratio=0.10), frames=MANY),
    _cell("corrupt 2 %", replace(_WIRE, corrupt_ratio=0.02), frames=MANY),
    _cell("reorder 20 %", Impairment(delay_s=10 * _MS, reorder_ratio=0.20), frames=MANY),
    _cell("reorder 50 %, gap 5", Impairment(delay_s=10 * _MS, reorder_ratio=0.50, reorder_gap=5), frames=MANY),
    _cell(
        "all at once",
        Impairment(
            delay_s=10 * _MS,
            jitter_s=1 * _MS,
            distribution=Distribution.NORMAL,
            loss=GilbertElliottLoss(p=0.02, r=0.50),
            duplicate_ratio=0.02,
            reorder_ratio=0.03,
            corrupt_ratio=0.01,
            rate_bps=20e6,
        ),
        frames=MANY,
        size_bytes=LARGE_BYTES,
    ),
)
_RADIOS = (
    _radio(
        "loss 10 %, delays 5, 7, 9 ms",
        Reach.BROADCAST,
        tuple(replace(_LOSSY, delay_s=d) for d in (5e-3, 7e-3, 9e-3)),
        MANY,
    ),
    _radio("Gilbert loss, p 1 %, r 25 %", Reach.BROADCAST, (replace(_WIRE, loss=_GILBERT),) * RECEIVERS, MANY),
    _radio("jitter 20 ± 4 ms, uniform", Reach.BROADCAST, (_UNIFORM,) * RECEIVERS, SOME),
    _radio(
        "loss 10 %, 5 ms; 1 % and 50 ms to others",
        Reach.RADIO,
        (Impairment(delay_s=0.05, loss=RandomLoss(0.01)), _LOSSY, Impairment(delay_s=0.05)),
        MANY,
    ),
)
_CHANGES = (
    _cell("change: loss 2 % → 10 %", replace(_WIRE, loss=RandomLoss(0.02)), _LOSSY, frames=MANY),
    _cell("change: delay 30 → 10 ms", Impairment(delay_s=30 * _MS), Impairment(delay_s=10 * _MS), frames=SOME),
    _cell("change: jitter normal → uniform", _NORMAL, _UNIFORM, frames=SOME),
    _cell(
        "change: Gilbert-Elliott → loss 1 %",
        replace(_WIRE, loss=_ELLIOTT),
        replace(_WIRE, loss=RandomLoss(0.01)),
        frames=MANY,
    ),
    _cell(
        "change: rate 8.77 → 9.31 Mbit/s",
        _BUSY,
        replace(_BUSY, rate_bps=9.31e6),
        frames=SOME,
        size_bytes=LARGE_BYTES,
        skip=2000,
    ),
    _cell("change: everything → nothing", _OTHERS[-1].phases[0][0], PERFECT, frames=MANY, size_bytes=LARGE_BYTES),
    _cell(
        "Gilbert loss, p 1 %, r 25 %, changed every 20 frames",
        replace(_WIRE, loss=_GILBERT),
        frames=2 * MANY,
        changed_every=20,
    ),
)

CELLS: tuple[Cell, ...] = (*_DELAYS, *_LOSSES, *_QUEUES, *_OTHERS, *_RADIOS, *_CHANGES)


def scaled(cell: Cell, frames: int) -> Cell:
    """The cell with at most ``frames`` frames a phase, for short tests."""
    return replace(cell, frames=min(frames, cell.frames), skip=min(cell.skip, frames // 10))
