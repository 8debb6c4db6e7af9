"""From what a person did in a run to events of a scenario file that do the same at the same times.

Owns the translation only: rows of ``/timeline`` in, plain values as in a file out. All times of the result are run time
(see :mod:`netlab.timeline.schedule`): events that a hold made later, or a step earlier, get the times that they really
had; motion stands still by ``hold`` events.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from netlab.scenario.quantities import DURATION, SPEED

Values = dict[str, Any]
_SHORTEST_S = 0.001


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the timeline as it was recorded."""

    payload: Mapping[str, Any]

    @property
    def at_s(self) -> float:
        """Run time; what comes before t = 0 counts as then."""
        at_s = self.payload.get("at_s")
        return max(0.0, float(at_s)) if isinstance(at_s, int | float) else 0.0

    @property
    def act(self) -> Mapping[str, Any]:
        """The person's act, empty if it is none."""
        act = self.payload.get("act")
        return act if isinstance(act, Mapping) else {}

    @property
    def event(self) -> int | None:
        """The place in the scenario's `events` that it came from."""
        event = self.payload.get("event")
        return event if isinstance(event, int) else None


@dataclass(frozen=True, slots=True)
class Replay:
    """What to put into the file. ``left_out`` names what no file can say, for the person."""

    events: list[Values]
    duration_s: float
    left_out: tuple[str, ...] = ()


def replay(events: Sequence[Values], rows: Sequence[Row], *, duration_s: float, end_s: float) -> Replay:
    """Make the events of a file that does again what happened.

    Args:
        events: The scenario's own, as in its file.
        rows: The whole timeline of the run so far, in order.
        duration_s: Of the scenario as it was begun.
        end_s: Run time up to which ``rows`` reach.
    """
    holds = _holds(rows, end_s)
    length_s = duration_s + sum(for_s for _, for_s in holds)
    made = _Made(length_s)
    for row in rows:
        if row.act and row.at_s < length_s:
            made.take(row.at_s, row.act)
    own = [
        _as_happened(event, [row.at_s for row in rows if row.event == index], holds)
        for index, event in enumerate(events)
        if event.get("deploy") not in made.deployed
    ]
    stands = [{"at": _time(from_s), "hold": _time(for_s)} for from_s, for_s in holds]
    whole = [event for event in own if DURATION.parse(event["at"]) < length_s] + stands + made.finish()
    return Replay(whole, length_s, tuple(made.left_out))


def _holds(rows: Sequence[Row], end_s: float) -> list[tuple[float, float]]:
    holds: list[tuple[float, float]] = []
    since_s: float | None = None
    for row in rows:
        if row.act.get("do") == "hold":
            since_s = row.at_s
        elif row.act.get("do") == "resume" and since_s is not None:
            holds.append((since_s, max(_SHORTEST_S, row.at_s - since_s)))
            since_s = None
    return holds if since_s is None else [*holds, (since_s, max(_SHORTEST_S, end_s - since_s))]


def _as_happened(event: Values, happened_s: list[float], holds: list[tuple[float, float]]) -> Values:
    """The event at the times that it had, or would have had by the holds so far."""
    at_s = DURATION.parse(event["at"])
    began_s = happened_s[0] if happened_s else _later(at_s, holds)
    if abs(began_s - at_s) < _SHORTEST_S:
        began_s = at_s  # on time: as the file says it
    changed = {**event, "at": _time(began_s)} if began_s != at_s else event

    def lasting(length: object) -> str:
        length_s = DURATION.parse(length)
        if began_s == at_s and _later(at_s + length_s, holds) == at_s + length_s:
            return str(length)
        ended_s = happened_s[-1] if len(happened_s) > 1 else _later(at_s + length_s, holds)
        return _time(max(_SHORTEST_S, ended_s - began_s))

    if "outage" in event:
        return {**changed, "outage": {**event["outage"], "for": lasting(event["outage"]["for"])}}
    if "flap" in event:
        until_s = DURATION.parse(event["flap"]["until"])
        until = event["flap"]["until"] if _later(until_s, holds) == until_s else _time(_later(until_s, holds))
        return {**changed, "flap": {**event["flap"], "until": until}}
    for key in ("restart", "hold"):
        if key in event:
            return {**changed, key: lasting(event[key])}
    return changed


def _later(script_s: float, holds: list[tuple[float, float]]) -> float:
    run_s = script_s
    for from_s, for_s in holds:
        run_s += for_s if from_s < run_s else 0.0
    return run_s


@dataclass(slots=True)
class _Made:
    """Events in the making: those that last are open until the act that ends them."""

    length_s: float
    events: list[tuple[float, Values]] = field(default_factory=list)
    deployed: set[str] = field(default_factory=set)
    left_out: list[str] = field(default_factory=list)
    _open: dict[tuple[object, ...], tuple[float, Values]] = field(default_factory=dict)

    def take(self, t_s: float, act: Mapping[str, Any]) -> None:
        match act.get("do"):
            case "outage":
                self._lasting(t_s, ("outage", *_directions(act)), act, begins=bool(act["active"]))
            case "carrier":
                self._lasting(t_s, ("carrier", frozenset(act["between"])), act, begins=not act["up"])
            case "flap":
                self._open["flap", frozenset(act["between"])] = (t_s, dict(act))
            case "flap_end":
                self._close(("flap", frozenset(act["between"])), t_s)
            case "link" if act["words"]:
                self.events.append((t_s, {"link": {**_ends(act), **act["words"]}}))
            case "move":
                speed = {} if act.get("speed_mps") is None else {"speed": SPEED.format(act["speed_mps"])}
                self.events.append((t_s, {"move": {"node": act["node"], "to": act["to"], **speed}}))
            case "deploy":
                self.deployed.add(str(act["node"]))
                self.events.append((t_s, {"deploy": act["node"]}))
            case "kill":
                self._open["kill", act["node"], act["process"]] = (t_s, dict(act))
            case "start":
                if ("kill", act["node"], act["process"]) in self._open:
                    self._close(("kill", act["node"], act["process"]), t_s)
                else:
                    self.left_out.append(f"start of {act['process']} on {act['node']}: it had ended by itself")
            case "mark":
                self.events.append((t_s, {"mark": act["text"]}))

    def finish(self) -> list[Values]:
        """All events in the order of time; what is still open lasts to the end."""
        for key in tuple(self._open):
            self._close(key, None)
        return [{"at": _time(t_s), **event} for t_s, event in sorted(self.events, key=lambda item: item[0])]

    def _lasting(self, t_s: float, key: tuple[object, ...], act: Mapping[str, Any], *, begins: bool) -> None:
        if begins:
            self._open.setdefault(key, (t_s, dict(act)))
            return
        ends = {(sender, receiver) for sender, receiver in _directions(act)} if "active" in act else None
        for other in tuple(self._open):
            kind, *rest = other
            whole = ends is None and _between(self._open[other][1]) == frozenset(act["between"])
            if kind in ("outage", "carrier") and (whole or (kind == "outage" and ends and ends >= set(rest))):
                self._close(other, t_s)

    def _close(self, key: tuple[object, ...], t_s: float | None) -> None:
        if key not in self._open:
            return
        began_s, act = self._open.pop(key)
        until_s = self.length_s if t_s is None else t_s
        lasted_s = max(_SHORTEST_S, until_s - began_s)
        ends = _ends(act)
        match key[0]:
            case "outage":
                event: Values = {"outage": {**ends, "for": _time(lasted_s)}}
            case "carrier":
                until = _time(began_s + lasted_s)
                event = {"flap": {**ends, "down": _time(lasted_s), "up": "1s", "until": until}}
            case "flap":
                planned_s = began_s + float(act["for_s"])
                until = _time(planned_s if t_s is None else max(began_s + _SHORTEST_S, min(t_s, planned_s)))
                event = {"flap": {**ends, "down": _time(act["down_s"]), "up": _time(act["up_s"]), "until": until}}
            case _:
                restart = {} if t_s is None else {"restart": _time(lasted_s)}
                event = {"kill": {"node": act["node"], "process": act["process"]}, **restart}
        self.events.append((began_s, event))


def _ends(act: Mapping[str, Any]) -> Values:
    if "between" not in act:
        return {}
    a, b = act["between"]
    over = {"over": act["over"]} if act.get("over") else {}
    return ({"from": a, "to": b} if act.get("one_way") else {"between": [a, b]}) | over


def _between(act: Mapping[str, Any]) -> frozenset[str]:
    return frozenset(act.get("between", ()))


def _directions(act: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    a, b = act["between"]
    return ((a, b),) if act.get("one_way") else tuple(sorted(((a, b), (b, a))))


def _time(value_s: float) -> str:
    return DURATION.format(round(float(value_s), 3))
