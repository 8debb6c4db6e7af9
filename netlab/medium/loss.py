"""Loss models as small state machines: one ``lost()`` per frame. Pure; the meanings are sch_netem's.

A model that replaces one of its own kind takes over its state, so that a change of ratios in mid-burst (a robot that
moves) neither ends the burst nor restarts a period.
"""

from __future__ import annotations

import random
from typing import Protocol

from netlab.medium.chance import Chance
from netlab.medium.impairments import (
    FourStateLoss,
    GilbertElliottLoss,
    LossModel,
    PeriodicLoss,
    RandomLoss,
    TraceLoss,
)


class LossProcess(Protocol):
    """Decides frame by frame."""

    def lost(self) -> bool:
        """Draw for one frame."""


def make_loss(model: LossModel, rng: random.Random, before: LossProcess | None = None) -> LossProcess:
    """Return the process of ``model``, continuing ``before`` where that is of the same kind."""
    if isinstance(model, RandomLoss):
        return _Random(model, rng, before if isinstance(before, _Random) else None)
    if isinstance(model, GilbertElliottLoss):
        return _GilbertElliott(model, rng, before if isinstance(before, _GilbertElliott) else None)
    if isinstance(model, FourStateLoss):
        return _FourState(model, rng, before if isinstance(before, _FourState) else None)
    return _Counted(model, before if isinstance(before, _Counted) else None)


class _Random:
    __slots__ = ("_chance", "lost")

    def __init__(self, model: RandomLoss, rng: random.Random, before: _Random | None) -> None:
        self._chance: Chance = Chance(rng, model.loss_ratio, model.correlation, before._chance if before else None)
        self.lost = self._chance.hit


class _GilbertElliott:
    """Moves first, then draws the loss by the state that it came from (loss_gilb_ell in sch_netem.c)."""

    __slots__ = ("_bad", "_model", "_random")

    def __init__(self, model: GilbertElliottLoss, rng: random.Random, before: _GilbertElliott | None) -> None:
        self._model = model
        self._random = rng.random
        self._bad: bool = before._bad if before else False

    def lost(self) -> bool:
        model, draw = self._model, self._random
        was_bad = self._bad
        if draw() < (model.r if was_bad else model.p):
            self._bad = not was_bad
        return draw() < (model.loss_in_bad if was_bad else model.loss_in_good)


class _FourState:
    """States as in Salsano et al.: 1 received in a gap, 2 received in a burst, 3 lost in a burst, 4 lost in a gap.

    A frame is lost on *entering* 3 or 4. Where p13 + p14 or p31 + p32 exceed 1, p14 and p32 come first, as in
    loss_4state of sch_netem.c.
    """

    __slots__ = ("_model", "_random", "_state")

    def __init__(self, model: FourStateLoss, rng: random.Random, before: _FourState | None) -> None:
        self._model = model
        self._random = rng.random
        self._state: int = before._state if before else 1

    def lost(self) -> bool:
        self._state = self._next(self._random())
        return self._state >= 3

    def _next(self, value: float) -> int:
        model = self._model
        if self._state == 1:
            return 4 if value < model.p14 else 3 if value < model.p14 + model.p13 else 1
        if self._state == 2:
            return 3 if value < model.p23 else 2
        if self._state == 3:
            return 2 if value < model.p32 else 1 if value < model.p32 + model.p31 else 3
        return 1


class _Counted:
    """Periodic and by trace: no chance involved, only the frame's number on this pair."""

    __slots__ = ("_count", "_model")

    def __init__(self, model: PeriodicLoss | TraceLoss, before: _Counted | None) -> None:
        self._model = model
        self._count: int = before._count if before and type(before._model) is type(model) else 0

    def lost(self) -> bool:
        number, model = self._count, self._model
        self._count += 1
        if isinstance(model, TraceLoss):
            return bool(model.pattern) and model.pattern[number % len(model.pattern)]
        return number >= model.offset and (number - model.offset) % model.every == 0
