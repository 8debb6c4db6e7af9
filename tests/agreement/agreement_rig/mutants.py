"""Media that are wrong on purpose, by 1 % of loss or 1 ms: the judge must notice each of them in every cell. Pure."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

from agreement_rig import chains
from agreement_rig.cells import Cell
from agreement_rig.through_medium import Distortion
from netlab.medium.pair import DROPPED, Outcome
from netlab.medium.verdicts import Verdict

WRONG_RATIO = 0.01
WRONG_S = 0.001


@dataclass(frozen=True, slots=True)
class Mutant:
    """``fits`` says whether a phase of a cell can show the error at all: without delay nothing comes sooner."""

    name: str
    fits: Callable[[Cell, int], bool]
    distortion: Callable[[Cell], Distortion]


def _loses_more(_cell: Cell) -> Distortion:
    rng = random.Random(1)

    def distort(outcome: Outcome, _now: float, _phase: int) -> Outcome:
        due, port, frame, _verdict = outcome
        return (DROPPED, port, frame, Verdict.LOST) if due >= 0 and rng.random() < WRONG_RATIO else outcome

    return distort


def _loses_less(cell: Cell) -> Distortion:
    rng = random.Random(2)
    saved_ratios = [min(1.0, WRONG_RATIO / (_loss_ratio(cell, phase) or 1.0)) for phase in range(len(cell.phases))]

    def distort(outcome: Outcome, now: float, phase: int) -> Outcome:
        _due, port, frame, verdict = outcome
        saved = verdict is Verdict.LOST and rng.random() < saved_ratios[phase]
        delay_s = cell.phases[phase][cell.judged[0]].delay_s
        return (now + delay_s, port, frame, Verdict.DELIVERED) if saved else outcome

    return distort


def _comes_later(_cell: Cell) -> Distortion:
    def distort(outcome: Outcome, _now: float, _phase: int) -> Outcome:
        due, port, frame, verdict = outcome
        return (due + WRONG_S, port, frame, verdict) if due >= 0 else outcome

    return distort


def _comes_sooner(_cell: Cell) -> Distortion:
    def distort(outcome: Outcome, now: float, _phase: int) -> Outcome:
        due, port, frame, verdict = outcome
        return (max(now, due - WRONG_S), port, frame, verdict) if due >= 0 else outcome

    return distort


def _loss_ratio(cell: Cell, phase: int) -> float:
    """By theory; 0 where there is none or theory does not know."""
    model = cell.phases[phase][cell.judged[0]].loss
    chain = None if model is None else chains.chain_of(model)
    return 0.0 if chain is None else chains.expected(chain, chains.is_lost).mean


def _always(_cell: Cell, _phase: int) -> bool:
    return True


def _is_lossy(cell: Cell, phase: int) -> bool:
    return _loss_ratio(cell, phase) > WRONG_RATIO * 0.99


def _is_delayed(cell: Cell, phase: int) -> bool:
    return cell.phases[phase][cell.judged[0]].delay_s > 0


MUTANTS = (
    Mutant("loses 1 % more", _always, _loses_more),
    Mutant("loses 1 % less", _is_lossy, _loses_less),
    Mutant("1 ms later", _always, _comes_later),
    Mutant("1 ms sooner", _is_delayed, _comes_sooner),
)
