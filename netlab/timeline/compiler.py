"""Events of a scenario to a schedule of actions on ports, sorted by time.

Theory: every outage and every down phase of a flap is a hold that is taken and released. Moments are worked off in the
order of time, at the same time beginnings before endings, so that one cut that follows another without a gap does not
let a single frame through. An entry appears only where something really changes; it restores two nodes when after it no
hold is left on anything between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING

from netlab.medium.impairments import Impairment
from netlab.scenario.events import Event, Flap, Kill, LinkChange, Outage
from netlab.scenario.link_trace import TraceRow
from netlab.scenario.model import Scenario
from netlab.scenario.motion import later
from netlab.timeline.entries import (
    Action,
    DeployNode,
    Entry,
    HoldMotion,
    KillProcess,
    Kind,
    MoveNode,
    Nothing,
    Pair,
    SetCarrier,
    SetOutage,
    SetPairs,
    StartProcess,
)
from netlab.timeline.holds import Hold, Holds
from netlab.timeline.impairments import Impairments
from netlab.timeline.labels import move_text, path_name, words_text
from netlab.timeline.paths import Hop, RadioWords, WireWords
from netlab.timeline.places import Places
from netlab.timeline.routes import with_routes

if TYPE_CHECKING:
    from netlab.engines.base import LabPlan


def compile_timeline(scenario: Scenario, plan: LabPlan) -> tuple[Entry, ...]:
    """Return what happens when, sorted by time; only endings can lie at or after the duration.

    Args:
        scenario: A checked scenario.
        plan: The plan that :func:`netlab.engines.plan.compile_plan` made of it.
    """
    compiler = _Compiler(scenario, plan)
    moments = sorted(compiler.moments(), key=lambda moment: (moment.at_s, moment.ends))
    entries = [replace(entry, event=moment.event) for moment in moments for entry in moment.entries(moment.at_s)]
    return with_routes(entries, scenario, plan)


@dataclass(frozen=True, slots=True)
class _Moment:
    """Something at a time, turned into entries when its turn comes; ``ends`` puts endings behind beginnings."""

    at_s: float
    ends: bool
    entries: Callable[[float], Iterator[Entry]]
    event: int | None = None


class _Compiler:
    def __init__(self, scenario: Scenario, plan: LabPlan) -> None:
        self._scenario = scenario
        self._places = Places(plan)
        self._holds = Holds()
        self._impairments = Impairments()
        self._wire_words = WireWords(scenario)
        self._radio_words = RadioWords(scenario) if scenario.radio is not None else None

    def moments(self) -> Iterator[_Moment]:
        yield from self._trace_moments()
        for index, event in enumerate(self._scenario.events):
            if event.at_s < self._scenario.duration_s:
                yield from (replace(moment, event=index) for moment in self._event_moments(event))

    def _event_moments(self, event: Event) -> Iterator[_Moment]:
        if event.outage is not None:
            end_s = event.at_s + event.outage.for_s
            yield from self._cut(event.at_s, end_s, event.outage, Hold(self._silent(event.outage)))
        elif event.flap is not None:
            hold = self._flap_hold(event.flap)
            for down_s, up_s in self._down_phases(event.at_s, event.flap):
                yield from self._cut(down_s, up_s, event.flap, hold)
        elif event.link is not None:
            yield _Moment(event.at_s, False, partial(self._change, event.link))
        elif event.kill is not None:
            yield from self._kill_moments(event, event.kill)
        elif event.deploy is not None:
            dropped = DeployNode(event.deploy, self._places.pairs_of(event.deploy))
            yield _Moment(event.at_s, True, partial(_alone, Kind.DEPLOY, f"deploy {event.deploy}", dropped))
        elif event.move is not None:
            moved = MoveNode(event.move.node)
            yield _Moment(event.at_s, False, partial(_alone, Kind.MOVE, move_text(event.move), moved))
        elif event.mark is not None:
            yield _Moment(event.at_s, False, partial(_alone, Kind.MARK, event.mark, Nothing()))
        elif event.hold_s is not None:
            yield _Moment(event.at_s, False, partial(_alone, Kind.HOLD, "motion stands still", HoldMotion(True)))
            goes_on = partial(_alone, Kind.RESUME, "motion goes on", HoldMotion(False))
            yield _Moment(event.at_s + event.hold_s, True, goes_on)

    def _silent(self, part: Outage | Flap) -> frozenset[Pair]:
        wire, radio = self._places.meant(part)
        return frozenset(wire | radio)

    def _flap_hold(self, flap: Flap) -> Hold:
        wire, radio = self._places.meant(flap)
        if flap.carrier and flap.between is not None:
            return Hold(frozenset(radio), frozenset(port for pair in wire for port in pair))
        return Hold(frozenset(wire | radio))

    def _down_phases(self, at_s: float, flap: Flap) -> Iterator[tuple[float, float]]:
        last_s = min(flap.until_s, self._scenario.duration_s)
        period_s = flap.down_s + flap.up_s
        for cycle in range(math.ceil((last_s - at_s) / period_s)):
            down_s = at_s + cycle * period_s
            if down_s < last_s:
                yield down_s, min(down_s + flap.down_s, flap.until_s)

    def _cut(self, from_s: float, to_s: float, part: Outage | Flap, hold: Hold) -> Iterator[_Moment]:
        yield _Moment(from_s, False, partial(self._begin, part, hold))
        yield _Moment(to_s, True, partial(self._end, part, hold))

    def _begin(self, part: Outage | Flap, hold: Hold, at_s: float) -> Iterator[Entry]:
        fell = self._holds.take(hold)
        flap = isinstance(part, Flap)
        kind = Kind.FLAP_DOWN if flap else Kind.OUTAGE
        label = f"flap {path_name(part)} down" if flap else f"outage {path_name(part)} begins"
        if fell.ports:
            yield Entry(at_s, kind, label, SetCarrier(fell.ports, up=False))
        if fell.pairs:
            yield Entry(at_s, kind, label, SetOutage(fell.pairs, active=True))

    def _end(self, part: Outage | Flap, hold: Hold, at_s: float) -> Iterator[Entry]:
        rose = self._holds.release(hold)
        flap = isinstance(part, Flap)
        kind = Kind.FLAP_UP if flap else Kind.OUTAGE_END
        label = f"flap {path_name(part)} up" if flap else f"outage {path_name(part)} ends"
        a, b = part.ends
        restores = (a, b) if self._are_joined(a, b) else None
        if rose.ports:
            yield Entry(at_s, kind, label, SetCarrier(rose.ports, up=True), None if rose.pairs else restores)
        if rose.pairs:
            yield Entry(at_s, kind, label, SetOutage(rose.pairs, active=False), restores)

    def _change(self, change: LinkChange, at_s: float) -> Iterator[Entry]:
        changes: dict[Pair, Impairment | None] = {}
        for hop in change.directions:
            wire = self._places.wire(hop) if change.over != "radio" else None
            radios = self._places.radios(hop)
            if wire is not None:
                self._wire_words.change(hop, change)
                changes[wire] = self._impairments.of(self._wire_words.get(hop))
            elif radios and self._radio_words is not None:
                self._radio_words.change(hop, change)
                changes |= dict.fromkeys(radios, self._heard(self._radio_words, hop))
        yield Entry(at_s, Kind.LINK, f"link {path_name(change)}: {words_text(change)}", SetPairs(changes))

    def _heard(self, radio_words: RadioWords, hop: Hop) -> Impairment | None:
        words = radio_words.get(hop)
        return None if words is None else self._impairments.of(words)

    def _kill_moments(self, event: Event, kill: Kill) -> Iterator[_Moment]:
        node, process = kill.node, kill.process
        killed = partial(_alone, Kind.KILL, f"kill {process} on {node}", KillProcess(node, process))
        yield _Moment(event.at_s, False, killed)
        if event.restart_s is not None:
            started = partial(_alone, Kind.START, f"start {process} on {node}", StartProcess(node, process))
            yield _Moment(event.at_s + event.restart_s, True, started)

    def _trace_moments(self) -> Iterator[_Moment]:
        if self._radio_words is None:
            return
        rows = [row for row in self._radio_words.later_rows if row.at_s < self._scenario.duration_s]
        for moment_s, together in groupby(rows, key=lambda row: row.at_s):
            change = partial(self._trace, self._radio_words, tuple(together))
            yield _Moment(later(moment_s, self._scenario.holds), False, change)

    def _trace(self, radio_words: RadioWords, rows: tuple[TraceRow, ...], at_s: float) -> Iterator[Entry]:
        changes: dict[Pair, Impairment | None] = {}
        came: list[Hop] = []
        for row in rows:
            hop = (row.sender, row.receiver)
            was_heard = radio_words.get(hop) is not None
            radio_words.apply(row)
            changes |= dict.fromkeys(self._places.radios(hop), self._heard(radio_words, hop))
            if not was_heard and radio_words.get(hop) is not None:
                came.append(hop)
        for a, b in dict.fromkeys((min(hop), max(hop)) for hop in came):
            plain = self._scenario.meshes[a] is None and self._places.wire((a, b)) is None
            if plain and self._are_joined(a, b):
                own = {pair: changes.pop(pair) for pair in self._places.all_between(a, b) & changes.keys()}
                yield Entry(at_s, Kind.TRACE, f"radio trace: {a} and {b} hear each other", SetPairs(own), (a, b))
        if changes:
            plural = "" if len(changes) == 1 else "s"
            yield Entry(at_s, Kind.TRACE, f"radio trace: {len(changes)} pair{plural}", SetPairs(changes))

    def _are_joined(self, a: str, b: str) -> bool:
        """Whether nothing holds anything between two nodes down, and their radios, without a wire, are in range."""
        words = self._radio_words
        if words is not None and self._places.wire((a, b)) is None and None in (words.get((a, b)), words.get((b, a))):
            return False
        return self._holds.free(self._places.all_between(a, b))


def _alone(kind: Kind, label: str, action: Action, at_s: float) -> Iterator[Entry]:
    yield Entry(at_s, kind, label, action)
