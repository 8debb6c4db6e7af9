"""The page of the documentation that the command writes: tables of what was found, set into a fixed text. Pure."""

from __future__ import annotations

import string
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from agreement_rig import judge
from agreement_rig.cells import Cell
from agreement_rig.judge import Figure, Kind, Verdict
from agreement_rig.trial import MEDIUM, CellResult, MutantResult, Outcome

_TEXT = Path(__file__).with_name("page.md")
CANDIDATES = ("netem", "air", MEDIUM)


def page(outcome: Outcome, kernel: str, seed: int) -> str:
    """The whole page, for the kernel that netem ran in."""
    figures = [figure for result in outcome.cells for figure in result.figures]
    assert outcome.same is not None
    values = {
        "kernel": kernel,
        "seed": str(seed),
        "cells": str(len(outcome.cells)),
        "frames": f"{sum(result.cell.ticks for result in outcome.cells):,}",
        "fewest": f"{min(result.cell.frames - result.cell.skip for result in outcome.cells):,}",
        "figures": str(len(figures)),
        "zeros": str(sum(_is_zero(figure) for figure in figures)),
        "verdict": _verdict(outcome),
        "table": "\n".join(_table(outcome.cells)),
        "mutants": "\n".join(map(_mutant, outcome.mutants)),
        "receptions": f"{outcome.same.receptions:,}",
        "differing": str(outcome.same.differing),
        "same_us": f"{outcome.same.delay_s * 1e6:.1f}",
        "outside": _outside(figures),
        "grain": f"{judge.GRAIN_RATIO:.2%}",
        "timer_ms": f"{judge.TIMER_S * 1e3:g}",
    }
    return string.Template(_TEXT.read_text()).substitute(values)


def _verdict(outcome: Outcome) -> str:
    if not outcome.failures:
        return "**They agree**, and every medium that is wrong on purpose is found out."
    return "**They do not agree**:\n\n" + "\n".join(f"* {failure}" for failure in outcome.failures)


def _table(results: Sequence[CellResult]) -> list[str]:
    lines = ["| cell | over | frames | figure | must be | netem | air | medium | bound | |", "|" + "---|" * 10]
    for result in results:
        first = True
        for figure in result.figures:
            if _is_zero(figure):
                continue
            cell = result.cell
            head = f"{cell.name} | {cell.reach.value} | {_frames(cell)}" if first else " | | "
            lines.append(f"| {head} | {_row(cell, figure)} |")
            first = False
    return lines


def _frames(cell: Cell) -> str:
    judged = f"{cell.frames - cell.skip:,}"
    return judged if len(cell.phases) == 1 else f"{len(cell.phases)} x {judged}"


def _row(cell: Cell, figure: Figure) -> str:
    half = f", {'first' if figure.phase == 0 else 'second'} half" if len(cell.phases) > 1 else ""
    receiver = f" {figure.receiver}" if figure.receiver else ""
    values = [_value(figure, name) for name in CANDIDATES]
    verdict = "agrees" if figure.passed else "FAILS"
    return " | ".join([figure.name + receiver + half, _must(figure), *values, _bound(figure), verdict])


def _must(figure: Figure) -> str:
    if figure.kind is Kind.DELAY:
        text = " / ".join(f"{value_s * 1e3:.2f}" for value_s in figure.marks) + " ms"
    else:
        kernel, others = (_number(figure.kind, figure.verdicts[name].expected) for name in ("netem", MEDIUM))
        text = kernel if kernel == others else f"{others}; netem {kernel}"
    return text if figure.by_theory else text + " †"


def _value(figure: Figure, name: str) -> str:
    verdict = figure.verdicts[name]
    if figure.kind is not Kind.DELAY:
        return _number(figure.kind, verdict.value)
    off_s = verdict.value - verdict.expected
    return f"{off_s * 1e3:+.3f} of {verdict.bound * 1e3:.3f} (p{figure.shares[name] * 100:.0f})"


def _bound(figure: Figure) -> str:
    if figure.kind is Kind.DELAY:
        return f"≤ {figure.widest_s * 1e3:.3f} ms"
    return "± " + _number(figure.kind, max(verdict.bound for verdict in figure.verdicts.values()))


def _number(kind: Kind, value: float) -> str:
    if kind is Kind.RATE:
        return f"{value / 1e6:.3f} Mbit/s"
    return f"{value:.3f}" if kind is Kind.CORRELATION else f"{value:.3%}".replace("%", " %")


def _is_zero(figure: Figure) -> bool:
    """Must be nothing and is nothing, everywhere: said once, not in every cell."""
    verdicts: list[Verdict] = list(figure.verdicts.values())
    return figure.kind is Kind.RATIO and not any(v.expected or v.value or v.bound for v in verdicts)


def _mutant(result: MutantResult) -> str:
    found = f"{result.tried - len(result.missed)} of {result.tried}"
    return f"| {result.name} | {found} | {result.nearest} | {result.nearest_excess:.1f} bounds |"


def _outside(figures: Sequence[Figure]) -> str:
    """How many figures are outside their own plain 99 % interval: a hundredth should be."""
    chance = [figure for figure in figures if figure.kind is Kind.RATIO and figure.by_theory]
    outside: Counter[str] = Counter()
    count = 0
    for figure in chance:
        for name, verdict in figure.verdicts.items():
            if verdict.error:
                count += name == CANDIDATES[0]
                outside[name] += abs(verdict.value - verdict.expected) > judge.Z_99 * verdict.error
    return f"{outside['netem']} of netem's, {outside['air']} of air's and {outside[MEDIUM]} of the medium's {count}"
