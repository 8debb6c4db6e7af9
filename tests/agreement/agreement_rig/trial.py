"""The whole agreement: what must be, what came of it, and what becomes of media that are wrong on purpose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from agreement_rig import fates, judge, mutants, references, through_medium
from agreement_rig.cells import Cell
from agreement_rig.judge import Figure
from agreement_rig.references import Reference
from agreement_rig.through_medium import Sending
from agreement_rig.tracks import Tracks

_FIRST_SAMPLE_SEED = 1_000
_SAMPLES = 4
_MUTANT_SEED = 2_000
MEDIUM = "medium"
AIR = "air"


@dataclass(frozen=True, slots=True)
class CellResult:
    """One cell and its figures, all phases."""

    cell: Cell
    figures: list[Figure]


@dataclass(frozen=True, slots=True)
class MutantResult:
    """``missed``: cells (and phases) that took a wrong medium for right. ``nearest``: the least clear of the others."""

    name: str
    tried: int
    missed: list[str]
    nearest: str
    nearest_excess: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the table says. ``same`` is None where air did not run."""

    cells: list[CellResult]
    mutants: list[MutantResult]
    same: fates.Fates | None

    @property
    def failures(self) -> list[str]:
        """Everything that does not hold, for a person."""
        return [*self.disagreements, *self.weaknesses]

    @property
    def disagreements(self) -> list[str]:
        """Figures outside their bounds, and air against the medium."""
        found = [
            f"{result.cell.name}, phase {figure.phase + 1}: {figure.name} {figure.receiver} of {name} is "
            f"{verdict.value:.6g}, must be {verdict.expected:.6g} +- {verdict.bound:.2g}"
            for result in self.cells
            for figure in result.figures
            for name, verdict in figure.verdicts.items()
            if not verdict.passed
        ]
        if self.same is not None and (self.same.differing or self.same.delay_s > judge.TIMER_S):
            found.append(f"air does not carry what the medium decides: {self.same}")
        return found

    @property
    def weaknesses(self) -> list[str]:
        """Where this comparison could not have found what it promises to find."""
        found = [f"a medium that {m.name} passes for right: {where}" for m in self.mutants for where in m.missed]
        found += [
            f"{result.cell.name}, phase {figure.phase + 1}: a quantile of the delay is bound by "
            f"{figure.widest_s * 1e3:.3f} ms, more than the {judge.PROMISED_S * 1e3:g} ms promised"
            for result in self.cells
            for figure in result.figures
            if figure.widest_s > judge.PROMISED_S
        ]
        return found


def references_of(cell: Cell) -> list[Reference]:
    """What must come of each phase."""
    samples: list[Tracks] = []
    if references.needs_samples(cell):
        samples = [through_medium.run([cell], _FIRST_SAMPLE_SEED + number)[0] for number in range(_SAMPLES)]
    return [references.reference(cell, phase, samples) for phase in range(len(cell.phases))]


def compare(
    cells: Sequence[Cell], runs: Mapping[str, Sequence[Tracks]], *, seed: int, air_sending: Sending | None
) -> Outcome:
    """Judge what engines did (``runs[engine][cell]``), and the pure medium, and the wrong ones.

    Args:
        cells: All of them.
        runs: By engine.
        seed: The lab's; with it the pure medium decides as air did.
        air_sending: When air's frames were sent; the pure medium gets them at the same times.
    """
    pure = through_medium.run(cells, seed, air_sending)
    must = [references_of(cell) for cell in cells]
    results = []
    for index, cell in enumerate(cells):
        candidates = {**{name: tracks[index] for name, tracks in runs.items()}, MEDIUM: pure[index]}
        figures = [
            figure
            for phase in range(len(cell.phases))
            for figure in judge.judge(cell, phase, must[index][phase], candidates)
        ]
        results.append(CellResult(cell, figures))
    wrong = [try_mutant(mutant, cells, must) for mutant in mutants.MUTANTS]
    return Outcome(results, wrong, fates.compare(runs[AIR], pure) if AIR in runs else None)


def try_mutant(mutant: mutants.Mutant, cells: Sequence[Cell], must: Sequence[Sequence[Reference]]) -> MutantResult:
    """Judge one wrong medium in every cell and phase that can show its error."""
    missed, tried = [], []
    for cell, references_ in zip(cells, must, strict=True):
        phases = [phase for phase in range(len(cell.phases)) if mutant.fits(cell, phase)]
        if not phases:
            continue
        tracks = through_medium.run([cell], _MUTANT_SEED, distort=mutant.distortion(cell))[0]
        for phase in phases:
            figures = judge.judge(cell, phase, references_[phase], {MEDIUM: tracks})
            excess, name = max((figure.verdicts[MEDIUM].excess, figure.name) for figure in figures)
            tried.append((excess, f"{cell.name}: {name}"))
            if excess <= 1:
                missed.append(f"{cell.name}, phase {phase + 1}")
    nearest = min(tried, default=(math.inf, "nothing tried"))
    return MutantResult(mutant.name, len(tried), missed, nearest[1], nearest[0])
