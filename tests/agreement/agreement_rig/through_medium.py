"""The cells through the pure medium, under a clock of numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from agreement_rig.cells import TICK_S, Cell, changed
from agreement_rig.lab import Place, build
from agreement_rig.tracks import Tracks, empty
from netlab.medium.impairments import Impairment
from netlab.medium.medium import Medium
from netlab.medium.pair import Outcome

_FIRST_TICK_S = 100.0

#: Wrong on purpose: what a medium makes of an outcome, knowing when the frame was sent and in which phase.
Distortion = Callable[[Outcome, float, int], Outcome]


@dataclass(frozen=True, slots=True)
class Sending:
    """When frames were sent (``ticks_s[k]``), and how many others each cell's sender had sent before."""

    ticks_s: Sequence[float]
    noise: Sequence[int]


def regular(cells: Sequence[Cell]) -> Sending:
    """One frame each tick, nothing before."""
    ticks = max(cell.ticks for cell in cells)
    return Sending([_FIRST_TICK_S + tick * TICK_S for tick in range(ticks)], [0] * len(cells))


def settings(cell: Cell, tick: int) -> tuple[Impairment, ...] | None:
    """What has to be set just before the cell's ``tick``-th frame; None: nothing new."""
    if tick >= cell.ticks:
        return None
    phase, number = divmod(tick, cell.frames)
    if cell.changed_every and number % cell.changed_every == 0:
        return tuple(changed(imp, number // cell.changed_every) for imp in cell.phases[phase])
    return cell.phases[phase] if phase and not number else None


def run(
    cells: Sequence[Cell], seed: int, sending: Sending | None = None, distort: Distortion | None = None
) -> list[Tracks]:
    """Send all frames of all cells; the same seed and times as an engine's run make the same decisions."""
    plan, places = build(cells, seed)
    medium = Medium(plan.ports, plan.segments, plan.seed)
    sending = sending or regular(cells)
    return [
        _run_cell(medium, place, noise, sending.ticks_s, distort)
        for place, noise in zip(places, sending.noise, strict=True)
    ]


def _run_cell(medium: Medium, place: Place, noise: int, ticks_s: Sequence[float], distort: Distortion | None) -> Tracks:
    cell = place.cell
    tracks = empty(cell)
    receivers = {port: receiver for receiver, port in enumerate(place.receivers)}
    for _ in range(noise):
        medium.transmit(place.sender, b"\xff" * 6 + place.frame(0)[6:], now=ticks_s[0] - 1)
    arrived: list[tuple[float, int, int, int, float, bool]] = []
    for tick in range(cell.ticks):
        wanted = settings(cell, tick)
        if wanted is not None:
            medium.set_pairs(dict(place.pairs(wanted)))
        phase, number = divmod(tick, cell.frames)
        frame, now = place.frame(tick), ticks_s[tick]
        for outcome in medium.transmit(place.sender, frame, now=now):
            due, port, received, _verdict = outcome if distort is None else distort(outcome, now, phase)
            if due >= 0:
                arrived.append((due, phase, number, receivers[port], now, received != frame))
    arrived.sort(key=lambda arrival: arrival[0])
    for due, phase, number, receiver, now, corrupted in arrived:
        tracks[phase][receiver].add(number, now, due - now, corrupted)
    return tracks
