"""What a person does to a running lab: one method per act, named ``_do_`` and the request's ``do``.

Each act is written to ``/timeline`` with its data under ``act`` (the request as plain values), from which
:mod:`netlab.timeline.replay` makes events of a scenario file. Of each act the inverse is known, and kept for ``undo``.
"""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from netlab.engines.base import Pair
from netlab.errors import LabError
from netlab.lab.effects import EXIT_LIMIT_S
from netlab.lab.flap import Flap
from netlab.lab.links import PERSON, parse_words
from netlab.lab.parts import Parts
from netlab.lab.process import State
from netlab.lab.readiness import READY_LIMIT_S, wait_for_state, wait_ready
from netlab.lab.scenario_run import ScenarioRun
from netlab.medium.impairments import PERFECT, Impairment
from netlab.medium.segments import SegmentKind
from netlab.timeline import DeployNode, Kind, carried_pairs
from netlab.timeline.impairments import impairment
from netlab.timeline.labels import impairment_words

Act = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Undoable:
    """An act that has been done, and how to take it back."""

    label: str
    undo: Callable[[], Awaitable[object]]


class Acts:
    """The acts on one lab, and how to take them back."""

    def __init__(self, parts: Parts, run: ScenarioRun) -> None:
        self._parts = parts
        self._run = run
        self._done: list[Undoable] = []
        self._flaps: dict[frozenset[str], asyncio.Task[None]] = {}

    @property
    def next_undo(self) -> str | None:
        """What ``undo`` would take back."""
        return self._done[-1].label if self._done else None

    async def do(self, request: Act) -> dict[str, Any] | None:
        """Carry out a request; None if it is not an act.

        Raises:
            LabError: It cannot be done.
        """
        method = getattr(self, f"_do_{request.get('do')}", None)
        if method is None:
            return None
        done = await method(request)
        if isinstance(done, Undoable):  # an undo calls the methods too, but what it does is not to be undone
            self._done.append(done)
            return {"ok": True}
        return done or {"ok": True}

    # -- links ----------------------------------------------------------------------------------------------------

    async def _do_outage(self, request: Act) -> Undoable:
        a, b = request["between"]
        one_way, active = bool(request.get("one_way")), bool(request["active"])
        pairs, kind = self._parts.links.between(a, b, one_way=one_way)
        self._parts.links.set_outage(PERSON, pairs, active=active)
        label = f"outage {_path(a, b, one_way)} {'begins' if active else 'ends'}"
        act = {"do": "outage", "between": [a, b], "one_way": one_way, "active": active, **self._over(a, b, kind)}
        self._record("outage", label, act, restores=None if active else (a, b))
        return Undoable(label, lambda: self._do_outage({**act, "active": not active}))

    async def _do_carrier(self, request: Act) -> Undoable:
        a, b = request["between"]
        up = bool(request["up"])
        pairs, kind = self._parts.links.between(a, b)
        if kind is not SegmentKind.WIRE:
            return await self._do_outage(request | {"active": not up})
        if up:  # whole again, also where one direction was cut
            self._parts.links.set_outage(PERSON, pairs, active=False)
        self._parts.links.set_carrier(PERSON, {port for pair in pairs for port in pair}, up=up)
        label = f"link {a}-{b} {'up' if up else 'down'}"
        act = {"do": "carrier", "between": [a, b], "up": up, **self._over(a, b, kind)}
        self._record("carrier", label, act, restores=(a, b) if up else None)
        return Undoable(label, lambda: self._do_carrier({"between": [a, b], "up": not up}))

    async def _do_flap(self, request: Act) -> Undoable:
        a, b = request["between"]
        up_s, down_s, for_s = (float(request[key]) for key in ("up_s", "down_s", "for_s"))
        if min(up_s, down_s, for_s) <= 0:
            raise LabError("a flap's times are above zero")
        pairs, kind = self._parts.links.between(a, b)
        key = frozenset((a, b))
        if key in self._flaps:
            raise LabError(f"{a}-{b} flaps already")
        flap = Flap(self._parts, self._run, a, b, frozenset(pairs), by_carrier=kind is SegmentKind.WIRE)
        times = {"up_s": up_s, "down_s": down_s, "for_s": for_s}
        act = {"do": "flap", "between": [a, b], **times, **self._over(a, b, kind)}
        label = f"flap {a}-{b}: down {down_s:g} s, up {up_s:g} s, for {for_s:g} s"
        self._record("flap", label, act)
        task = self._flaps[key] = asyncio.create_task(flap.run(up_s=up_s, down_s=down_s, for_s=for_s))
        task.add_done_callback(lambda _task: self._flaps.pop(key, None))
        return Undoable(label, lambda: self._do_flap_end({"between": [a, b]}))

    async def _do_flap_end(self, request: Act) -> None:
        a, b = request["between"]
        task = self._flaps.pop(frozenset((a, b)), None)
        if task is None:
            raise LabError(f"{a}-{b} does not flap")
        task.cancel()
        await asyncio.wait({task})
        self._record("flap_end", f"flap {a}-{b} is over", {"do": "flap_end", "between": [a, b]})

    async def _do_link(self, request: Act) -> Undoable:
        a, b = request["between"]
        one_way = bool(request.get("one_way"))
        pairs, kind = self._parts.links.between(a, b, one_way=one_way)
        words = parse_words(a, b, request["words"])
        if words.rssi_dbm is not None and any(self._parts.links.signals.rssi_dbm(pair) is not None for pair in pairs):
            raise LabError(f"link {a} {b}: rssi follows places, or a measured file, here; move a node, or set loss")
        before = {pair: self._parts.links.impairment(pair) for pair in pairs}
        self._parts.links.set_pairs({pair: impairment(words, before[pair] or PERFECT) for pair in pairs})
        label = f"link {_path(a, b, one_way)}: " + ", ".join(f"{key}={v}" for key, v in request["words"].items())
        words_given = dict(request["words"])
        act = {"do": "link", "between": [a, b], "one_way": one_way, "words": words_given, **self._over(a, b, kind)}
        self._record(Kind.LINK, label, act)
        return Undoable(label, lambda: self._restore_link(act, before))

    async def _restore_link(self, act: Act, before: dict[Pair, Impairment | None]) -> None:
        """Lay the former words over again; recorded one direction at a time where they differ."""
        self._parts.links.set_pairs(before)
        for (sender, receiver), former in before.items():
            a, b = (self._parts.plan.ports[port].node for port in (sender, receiver))
            words = impairment_words(former or PERFECT, act["words"])
            label = f"link {a}->{b}: " + ", ".join(f"{key}={value}" for key, value in words.items())
            self._record(Kind.LINK, label, {**act, "between": [a, b], "one_way": True, "words": words})

    # -- nodes ----------------------------------------------------------------------------------------------------

    async def _do_move(self, request: Act) -> Undoable:
        node, speed_mps = request["node"], request.get("speed_mps")
        to_m = tuple(map(float, request["to"]))
        motion = self._parts.motion
        was_m = motion.place(node) if node in self._parts.plan.nodes else ()
        motion.move(node, to_m, at_s=motion.now_s(), speed_mps=speed_mps)
        label = f"move {node} to [{', '.join(f'{value:g}' for value in to_m)}]"
        act = {"do": "move", "node": node, "to": list(to_m), "speed_mps": speed_mps}
        self._record(Kind.MOVE, label, act)
        back = [round(value, 2) for value in was_m]
        return Undoable(label, lambda: self._do_move({"node": node, "to": back}))

    async def _do_deploy(self, request: Act) -> Undoable:
        node = request["node"]
        carried = carried_pairs(self._parts.scenario, self._parts.plan)
        if node not in carried:
            known = ", ".join(carried) or "nothing"
            raise LabError(f"nobody carries '{node}'; carried in this scenario: {known}")
        if self._run.t_s is None:
            raise LabError(f"'{node}' can be dropped once the scenario runs")
        self._parts.motion.deploy(node)
        self._run.playback.drop_deployment(node)
        action, act = DeployNode(node, carried[node]), {"do": "deploy", "node": node}
        await self._run.effects.apply(action, Kind.DEPLOY, f"deploy {node}", at_s=self._run.t_s, act=act)
        return Undoable(f"deploy {node}", lambda: _refuse(f"'{node}' lies on the ground; nobody picks it up again"))

    async def _do_kill(self, request: Act) -> Undoable:
        node, name = request["node"], request["process"]
        process = self._parts.processes.get(node, name)
        if process.state is State.EXITED:
            raise LabError(f"{node}: {name} is not running")
        self._record(Kind.KILL, f"kill {name} on {node}", {"do": "kill", "node": node, "process": name})
        self._parts.processes.stop(process, signal.SIGKILL)
        await wait_for_state(process, State.EXITED, EXIT_LIMIT_S)
        return Undoable(f"kill {name} on {node}", lambda: self._do_start({"node": node, "process": name}))

    async def _do_start(self, request: Act) -> Undoable:
        node, name = request["node"], request["process"]
        process = self._parts.processes.get(node, name)
        if process.state is not State.EXITED:
            raise LabError(f"{node}: {name} is {process.state} already")
        self._record(Kind.START, f"start {name} on {node}", {"do": "start", "node": node, "process": name})
        self._parts.processes.start(process.spec)
        await wait_ready([process], READY_LIMIT_S)
        return Undoable(f"start {name} on {node}", lambda: self._do_kill({"node": node, "process": name}))

    # -- the timeline and the recording ---------------------------------------------------------------------------

    async def _do_mark(self, request: Act) -> None:
        """Mark now, or the moment ``ago_s`` before: it takes a person a while to say what it was."""
        text = str(request["text"]).strip()[:200] or "mark"
        self._record(Kind.MARK, text, {"do": "mark", "text": text}, ago_s=max(0.0, float(request.get("ago_s", 0.0))))

    async def _do_hold(self, _request: Act) -> None:
        self._run.hold()
        self._record(Kind.HOLD, "the timeline stands still", {"do": "hold"})

    async def _do_resume(self, _request: Act) -> None:
        self._run.resume()
        self._record(Kind.RESUME, "the timeline goes on", {"do": "resume"})

    async def _do_step(self, _request: Act) -> dict[str, Any]:
        entries = await self._run.step()
        return {"ok": True, "labels": list(dict.fromkeys(entry.label for entry in entries))}

    async def _do_record(self, request: Act) -> dict[str, Any]:
        """Go on in another file, or (no file) record nothing from now on."""
        path = request.get("file")
        recording = self._parts.recording
        if path is None:
            self._record("recording", "the recording ends", {"do": "record", "file": None})
            recording.close_file()
        else:
            recording.open_file(Path(path))
            self._record("recording", f"recording to {Path(path).name}", {"do": "record", "file": str(path)})
        return {"ok": True, "file": recording.file}

    async def _do_undo(self, _request: Act) -> dict[str, Any]:
        if not self._done:
            raise LabError("there is nothing to undo")
        last = self._done.pop()
        await last.undo()
        return {"ok": True, "label": last.label}

    def _over(self, a: str, b: str, kind: SegmentKind) -> dict[str, str]:
        """Which of the two is meant, where a wire and a radio join two nodes."""
        return {"over": kind.value} if len(self._parts.scenario.joined(a, b)) > 1 else {}

    def _record(
        self, kind: str, label: str, act: Act, *, restores: tuple[str, str] | None = None, ago_s: float = 0.0
    ) -> None:
        recording, t_s = self._parts.recording, self._run.t_s
        at_s = None if t_s is None else t_s - ago_s
        both = list(restores) if restores else None
        recording.timeline(kind, label, at_s=at_s, ago_s=ago_s, restores=both, act=act)
        if act["do"] in ("outage", "carrier", "link"):
            recording.links(self._parts.links.describe())


def _path(a: str, b: str, one_way: bool) -> str:
    return f"{a}->{b}" if one_way else f"{a}-{b}"


async def _refuse(text: str) -> None:
    raise LabError(text)
