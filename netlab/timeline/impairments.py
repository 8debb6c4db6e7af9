"""From the words of a scenario file to the values of the medium."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from netlab.medium.impairments import (
    PERFECT,
    Distribution,
    FourStateLoss,
    GilbertElliottLoss,
    Impairment,
    LossModel,
    PeriodicLoss,
    RandomLoss,
    TraceLoss,
)
from netlab.scenario.words import Loss, Words


def impairment(words: Words, base: Impairment = PERFECT) -> Impairment:
    """Return what ``words`` mean, laid over ``base``; the default is netem's (no effect, 1000 packets of queue)."""
    values: dict[str, Any] = {}
    for name in ("delay_s", "jitter_s", "delay_correlation", "rate_bps", "rssi_dbm"):
        if (value := getattr(words, name)) is not None:
            values[name] = value
    for name in ("duplicate", "reorder", "corrupt"):
        if (chance := getattr(words, name)) is not None:
            values |= {f"{name}_ratio": chance.ratio, f"{name}_correlation": chance.correlation}
    if words.reorder is not None:
        values["reorder_gap"] = words.reorder.gap
    if words.distribution is not None:
        values["distribution"] = Distribution(words.distribution)
    if words.loss is not None:
        values["loss"] = loss_model(words.loss)
    if words.limit is not None:
        values |= {"limit_packets": words.limit.packets, "limit_bytes": words.limit.size_bytes}
    return replace(base, **values)


def loss_model(loss: Loss) -> LossModel | None:
    """Return the loss model; None for a loss of 0 %. Left out, `r` is 1 - `p` and `p31` is 1 - `p13`, as in tc."""
    if loss.gemodel is not None:
        model = loss.gemodel
        recovery = 1 - model.p if model.r is None else model.r
        return GilbertElliottLoss(model.p, recovery, model.loss_in_bad, model.loss_in_good)
    if loss.state is not None:
        chain = loss.state
        p31 = 1 - chain.p13 if chain.p31 is None else chain.p31
        return FourStateLoss(chain.p13, p31, chain.p32, chain.p23, chain.p14)
    if loss.periodic is not None:
        return PeriodicLoss(loss.periodic.every, loss.periodic.offset)
    if loss.trace is not None:
        return TraceLoss(loss.trace)
    return RandomLoss(loss.ratio, loss.correlation or 0.0) if loss.ratio else None


class Impairments:
    """:func:`impairment` with a memory: the same words give the same object, however many pairs use them."""

    def __init__(self) -> None:
        self._known: dict[Words, Impairment] = {}

    def of(self, words: Words) -> Impairment:
        """Return what ``words`` mean."""
        known = self._known.get(words)
        if known is None:
            known = self._known[words] = impairment(words)
        return known
