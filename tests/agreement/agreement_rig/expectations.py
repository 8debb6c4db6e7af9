"""The figures of a cell, and what they must be where theory knows. Pure.

The figures of one phase are series over its frames (:mod:`agreement_rig.tracks`), whose mean is judged, and the
quantiles of the delay.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from agreement_rig import chains, shapes, tracks
from agreement_rig.cells import TICK_S, Cell, Reach
from agreement_rig.chains import Expected
from agreement_rig.tracks import Series, Track
from netlab.medium.impairments import Impairment, RandomLoss

#: Name of the figure, and of the receiver or receivers ("" where there is one).
Key = tuple[str, str]


def series(cell: Cell, phase: Sequence[Impairment], received: Sequence[Track]) -> dict[Key, Series]:
    """The judged series of one phase."""
    found: dict[Key, Series] = {}
    for receiver in cell.judged:
        imp, track, name = phase[receiver], received[receiver], label(cell, receiver)
        gone = tracks.lost(track)
        found["lost", name] = gone
        found["copies", name] = tracks.copies(track)
        found["corrupted", name] = tracks.corrupted(track)
        if imp.loss is not None and not cell.changed_every:
            found["loss bursts", name] = tracks.burst_starts(gone)
            found["single losses", name] = tracks.single_losses(gone)
        if imp.reorder_ratio:
            found["sent at once", name] = tracks.at_once(track)
    if cell.reach is Reach.RADIO:
        strangers = (tracks.arrivals(track) for index, track in enumerate(received) if index not in cell.judged)
        found["heard by others", ""] = bytearray(map(sum, zip(*strangers, strict=True)))
    if cell.reach is Reach.BROADCAST and phase[0].loss is not None:
        for one, other in itertools.combinations(cell.judged, 2):
            pair = f"{one + 1}+{other + 1}"
            found["lost at both", pair] = tracks.both(
                found["lost", label(cell, one)], found["lost", label(cell, other)]
            )
    return found


def theory(cell: Cell, phase: Sequence[Impairment]) -> dict[Key, Expected]:
    """Those of the series that theory knows."""
    known: dict[Key, Expected] = {("heard by others", ""): Expected(0.0, 0.0)}
    for receiver in cell.judged:
        for name, expected in _theory_of(phase[receiver]).items():
            known[name, label(cell, receiver)] = expected
    chain = None if phase[0].loss is None else chains.chain_of(phase[0].loss)
    if chain is not None:
        for one, other in itertools.combinations(cell.judged, 2):
            known["lost at both", f"{one + 1}+{other + 1}"] = chains.expected_jointly(chain)
    return known


def restarted(cell: Cell, phase: Sequence[Impairment]) -> dict[Key, Expected]:
    """What differs with netem, whose chain begins in the good state after every change."""
    model = phase[0].loss
    chain = None if model is None else chains.chain_of(model)
    if not cell.changed_every or chain is None:
        return {}
    return {("lost", ""): chains.expected_restarted(chain, cell.changed_every)}


def quantile_formula(cell: Cell, imp: Impairment) -> shapes.Quantile | None:
    """Quantiles of the delay, where a formula knows them."""
    at_once = _reordered(imp).mean if imp.reorder_ratio else 0.0
    if _fills_queue(imp) or (imp.loss is not None and at_once):
        return None
    return shapes.formula(imp, cell.size_bytes, at_once, TICK_S)


def saturated(cell: Cell, imp: Impairment) -> bool:
    """Whether the sender offers more than the rate."""
    return imp.rate_bps is not None and cell.size_bytes * 8 / imp.rate_bps > TICK_S


def label(cell: Cell, receiver: int) -> str:
    return str(receiver + 1) if len(cell.judged) > 1 else ""


def _fills_queue(imp: Impairment) -> bool:
    return imp.limit_packets is not None and imp.limit_packets * TICK_S < 2 * imp.delay_s + 0.1


def _theory_of(imp: Impairment) -> dict[str, Expected]:
    known: dict[str, Expected] = {}
    if not imp.duplicate_ratio:
        known["copies"] = Expected(0.0, 0.0)
    if not imp.corrupt_ratio:
        known["corrupted"] = Expected(0.0, 0.0)
    if imp.loss is None:
        known |= _theory_without_loss(imp)
    elif isinstance(imp.loss, RandomLoss) and imp.duplicate_ratio and not imp.loss.correlation:
        loss, duplicate = imp.loss.loss_ratio, imp.duplicate_ratio
        # A copy that is made of a lost frame replaces it; a copy of another is drawn for on its own.
        known["lost"] = _bernoulli((1 - duplicate) * loss)
        known["copies"] = _bernoulli(duplicate * (1 - loss) ** 2)
    elif not imp.duplicate_ratio and not _fills_queue(imp):
        known |= _theory_of_losses(imp)
    return known


def _theory_without_loss(imp: Impairment) -> dict[str, Expected]:
    known = {"copies": _bernoulli(imp.duplicate_ratio), "corrupted": _bernoulli(imp.corrupt_ratio)}
    if not _fills_queue(imp):
        known["lost"] = Expected(0.0, 0.0)
    if imp.reorder_ratio:
        known["sent at once"] = _reordered(imp)
    return known


def _theory_of_losses(imp: Impairment) -> dict[str, Expected]:
    chain = None if imp.loss is None else chains.chain_of(imp.loss)
    if chain is None:
        return {}
    return {
        "lost": chains.expected(chain, chains.is_lost),
        "loss bursts": chains.expected(chain, chains.starts_burst),
        "single losses": chains.expected(chain, chains.is_single),
    }


def _bernoulli(ratio: float) -> Expected:
    return Expected(ratio, ratio * (1 - ratio))


def _reordered(imp: Impairment) -> Expected:
    """A renewal process: gap - 1 frames are delayed, then each one leaves at once with the ratio, and so anew.

    Between two such frames lie m = gap - 1 + 1 / ratio on average, with the variance s = (1 - ratio) / ratio^2: V is
    s / m^3 (central limit theorem of renewal processes).
    """
    mean = imp.reorder_gap - 1 + 1 / imp.reorder_ratio
    return Expected(1 / mean, (1 - imp.reorder_ratio) / imp.reorder_ratio**2 / mean**3)
