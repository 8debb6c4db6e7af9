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
from typing import Any, Protocol

from netlab.engines.base import LabPlan, Pair
from netlab.errors import LabError
from netlab.lab.links import Links, parse_words
from netlab.lab.motion import Motion
from netlab.lab.process import State
from netlab.lab.processes import Processes
from netlab.lab.recording import Recording
from netlab.lab.scenario_run import READY_LIMIT_S, ScenarioRun, wait_for_state, wait_ready
from netlab.medium.impairments import PERFECT, Impairment
from netlab.medium.segments import SegmentKind
from netlab.timeline import DeployNode, Kind, carried_pairs
from netlab.timeline.impairments import impairment
from netlab.timeline.labels import impairment_words

PERSON = "person"  # who holds links down
Act = dict[str, Any]
Undo = Callable[[], Awaitable[None]]


class ActedOn(Protocol):
    """The parts of a lab that acts change."""

    plan: LabPlan
    links: Links
    processes: Processes
    recording: Recording
    motion: Motion
    run: ScenarioRun


@dataclass(frozen=True, slots=True)
class _Done:
    label: str
    undo: Undo


class Acts:
    """The acts on one lab, and how to take them back."""

    def __init__(self, lab: ActedOn) -> None:
        self._lab = lab
        self._done: list[_Done] = []
        self._flaps: dict[frozenset[str], asyncio.Task[None]] = {}
        self._undoing = False

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
        return (await method(request)) or {"ok": True}

    # -- links ----------------------------------------------------------------------------------------------------

    async def _do_outage(self, request: Act) -> None:
        a, b = request["between"]
        one_way, active = bool(request.get("one_way")), bool(request["active"])
        pairs, kind = self._lab.links.between(a, b, one_way=one_way)
        self._lab.links.set_outage(PERSON, pairs, active=active)
        label = f"outage {_path(a, b, one_way)} {'begins' if active else 'ends'}"
        act = {"do": "outage", "between": [a, b], "one_way": one_way, "active": active, **self._over(a, b, kind)}
        self._record("outage", label, act, restores=None if active else (a, b))
        self._can_undo(label, lambda: self._do_outage({**act, "active": not active}))

    async def _do_carrier(self, request: Act) -> None:
        a, b = request["between"]
        up = bool(request["up"])
        pairs, kind = self._lab.links.between(a, b)
        if kind is not SegmentKind.WIRE:
            await self._do_outage(request | {"active": not up})
            return
        if up:  # whole again, also where one direction was cut
            self._lab.links.set_outage(PERSON, pairs, active=False)
        self._lab.links.set_carrier(PERSON, {port for pair in pairs for port in pair}, up=up)
        label = f"link {a}-{b} {'up' if up else 'down'}"
        act = {"do": "carrier", "between": [a, b], "up": up, **self._over(a, b, kind)}
        self._record("carrier", label, act, restores=(a, b) if up else None)
        self._can_undo(label, lambda: self._do_carrier({"between": [a, b], "up": not up}))

    async def _do_flap(self, request: Act) -> None:
        a, b = request["between"]
        up_s, down_s, for_s = (float(request[key]) for key in ("up_s", "down_s", "for_s"))
        if min(up_s, down_s, for_s) <= 0:
            raise LabError("a flap's times are above zero")
        pairs, kind = self._lab.links.between(a, b)
        key = frozenset((a, b))
        if key in self._flaps:
            raise LabError(f"{a}-{b} flaps already")
        flap = _Flap(self._lab, a, b, pairs, by_carrier=kind is SegmentKind.WIRE)
        times = {"up_s": up_s, "down_s": down_s, "for_s": for_s}
        act = {"do": "flap", "between": [a, b], **times, **self._over(a, b, kind)}
        label = f"flap {a}-{b}: down {down_s:g} s, up {up_s:g} s, for {for_s:g} s"
        self._record("flap", label, act)
        task = self._flaps[key] = asyncio.create_task(flap.run(up_s=up_s, down_s=down_s, for_s=for_s))
        task.add_done_callback(lambda _task: self._flaps.pop(key, None))
        self._can_undo(label, lambda: self._do_flap_end({"between": [a, b]}))

    async def _do_flap_end(self, request: Act) -> None:
        a, b = request["between"]
        task = self._flaps.pop(frozenset((a, b)), None)
        if task is None:
            raise LabError(f"{a}-{b} does not flap")
        task.cancel()
        await asyncio.wait({task})
        self._record("flap_end", f"flap {a}-{b} is over", {"do": "flap_end", "between": [a, b]})

    async def _do_link(self, request: Act) -> None:
        a, b = request["between"]
        one_way = bool(request.get("one_way"))
        pairs, kind = self._lab.links.between(a, b, one_way=one_way)
        words = parse_words(a, b, request["words"])
        if words.rssi_dbm is not None and any(self._lab.links.signals.rssi_dbm(pair) is not None for pair in pairs):
            raise LabError(f"link {a} {b}: rssi follows places, or a measured file, here; move a node, or set loss")
        before = {pair: self._lab.links.impairment(pair) for pair in pairs}
        self._lab.links.set_pairs({pair: impairment(words, before[pair] or PERFECT) for pair in pairs})
        label = f"link {_path(a, b, one_way)}: " + ", ".join(f"{key}={v}" for key, v in request["words"].items())
        words_given = dict(request["words"])
        act = {"do": "link", "between": [a, b], "one_way": one_way, "words": words_given, **self._over(a, b, kind)}
        self._record(Kind.LINK, label, act)
        self._can_undo(label, lambda: self._restore_link(act, before))

    async def _restore_link(self, act: Act, before: dict[Pair, Impairment | None]) -> None:
        """Lay the former words over again; recorded one direction at a time where they differ."""
        self._lab.links.set_pairs(before)
        for (sender, receiver), former in before.items():
            a, b = (self._lab.plan.ports[port].node for port in (sender, receiver))
            words = impairment_words(former or PERFECT, act["words"])
            label = f"link {a}->{b}: " + ", ".join(f"{key}={value}" for key, value in words.items())
            self._record(Kind.LINK, label, {**act, "between": [a, b], "one_way": True, "words": words})

    # -- nodes ----------------------------------------------------------------------------------------------------

    async def _do_move(self, request: Act) -> None:
        node, speed_mps = request["node"], request.get("speed_mps")
        to_m = tuple(map(float, request["to"]))
        motion = self._lab.motion
        was_m = motion.place(node) if node in self._lab.plan.nodes else ()
        motion.move(node, to_m, at_s=motion.now_s(), speed_mps=speed_mps)
        label = f"move {node} to [{', '.join(f'{value:g}' for value in to_m)}]"
        act = {"do": "move", "node": node, "to": list(to_m), "speed_mps": speed_mps}
        self._record(Kind.MOVE, label, act)
        back = [round(value, 2) for value in was_m]
        self._can_undo(label, lambda: self._do_move({"node": node, "to": back}))

    async def _do_deploy(self, request: Act) -> None:
        node = request["node"]
        carried = carried_pairs(self._lab.run.scenario, self._lab.plan)
        if node not in carried:
            known = ", ".join(carried) or "nothing"
            raise LabError(f"nobody carries '{node}'; carried in this scenario: {known}")
        if self._lab.run.t_s is None:
            raise LabError(f"'{node}' can be dropped once the scenario runs")
        self._lab.motion.deploy(node)
        for entry in self._lab.run.schedule.coming:
            if isinstance(entry.action, DeployNode) and entry.action.node == node:
                self._lab.run.schedule.drop(entry)
        action = DeployNode(node, carried[node])
        await self._lab.run.apply(
            action, Kind.DEPLOY, f"deploy {node}", at_s=self._lab.run.t_s, act={"do": "deploy", "node": node}
        )
        self._can_undo(f"deploy {node}", lambda: _refuse(f"'{node}' lies on the ground; nobody picks it up again"))

    async def _do_kill(self, request: Act) -> None:
        node, name = request["node"], request["process"]
        process = self._lab.processes.get(node, name)
        if process.state is State.EXITED:
            raise LabError(f"{node}: {name} is not running")
        self._record(Kind.KILL, f"kill {name} on {node}", {"do": "kill", "node": node, "process": name})
        self._lab.processes.stop(process, signal.SIGKILL)
        await wait_for_state(process, State.EXITED, 5.0)
        self._can_undo(f"kill {name} on {node}", lambda: self._do_start({"node": node, "process": name}))

    async def _do_start(self, request: Act) -> None:
        node, name = request["node"], request["process"]
        process = self._lab.processes.get(node, name)
        if process.state is not State.EXITED:
            raise LabError(f"{node}: {name} is {process.state} already")
        self._record(Kind.START, f"start {name} on {node}", {"do": "start", "node": node, "process": name})
        self._lab.processes.start(process.spec)
        await wait_ready([process], READY_LIMIT_S)
        self._can_undo(f"start {name} on {node}", lambda: self._do_kill({"node": node, "process": name}))

    # -- the timeline and the recording ---------------------------------------------------------------------------

    async def _do_mark(self, request: Act) -> None:
        text = str(request["text"]).strip()[:200] or "mark"
        self._record(Kind.MARK, text, {"do": "mark", "text": text})

    async def _do_hold(self, _request: Act) -> None:
        self._lab.run.hold()
        self._record(Kind.HOLD, "the timeline stands still", {"do": "hold"})

    async def _do_resume(self, _request: Act) -> None:
        self._lab.run.resume()
        self._record(Kind.RESUME, "the timeline goes on", {"do": "resume"})

    async def _do_step(self, _request: Act) -> dict[str, Any]:
        entries = await self._lab.run.step()
        return {"ok": True, "labels": list(dict.fromkeys(entry.label for entry in entries))}

    async def _do_record(self, request: Act) -> dict[str, Any]:
        """Go on in another file, or (no file) record nothing from now on."""
        path = request.get("file")
        recording = self._lab.recording
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
        self._undoing = True  # an undo is an act, but not one to be undone
        try:
            await last.undo()
        finally:
            self._undoing = False
        return {"ok": True, "label": last.label}

    def _over(self, a: str, b: str, kind: SegmentKind) -> dict[str, str]:
        """Which of the two is meant, where a wire and a radio join two nodes."""
        return {"over": kind.value} if len(self._lab.run.scenario.joined(a, b)) > 1 else {}

    def _can_undo(self, label: str, undo: Undo) -> None:
        if not self._undoing:
            self._done.append(_Done(label, undo))

    def _record(self, kind: str, label: str, act: Act, *, restores: tuple[str, str] | None = None) -> None:
        lab = self._lab
        lab.recording.timeline(kind, label, at_s=lab.run.t_s, restores=list(restores) if restores else None, act=act)
        if act["do"] in ("outage", "carrier", "link"):
            lab.recording.links(lab.links.describe())


class _Flap:
    """One link that goes down and up."""

    def __init__(self, lab: ActedOn, a: str, b: str, pairs: set[Pair], *, by_carrier: bool) -> None:
        self._lab, self._ends, self._pairs, self._by_carrier = lab, (a, b), pairs, by_carrier

    async def run(self, *, up_s: float, down_s: float, for_s: float) -> None:
        """Down first; up again at the end, also when it is cancelled."""
        loop = asyncio.get_running_loop()
        end_s = loop.time() + for_s
        try:
            while (left_s := end_s - loop.time()) > 0:
                self._set(down=True)
                await asyncio.sleep(min(down_s, left_s))
                self._set(down=False)
                await asyncio.sleep(min(up_s, max(0.0, end_s - loop.time())))
        except asyncio.CancelledError:
            self._set(down=False)

    def _set(self, *, down: bool) -> None:
        a, b = self._ends
        holder = f"{PERSON} flap {a}-{b}"
        if self._by_carrier:
            self._lab.links.set_carrier(holder, {port for pair in self._pairs for port in pair}, up=not down)
        else:
            self._lab.links.set_outage(holder, self._pairs, active=down)
        kind, word = (Kind.FLAP_DOWN, "down") if down else (Kind.FLAP_UP, "up")
        restores = None if down else [a, b]
        self._lab.recording.timeline(kind, f"flap {a}-{b} {word}", at_s=self._lab.run.t_s, restores=restores)
        self._lab.recording.links(self._lab.links.describe())


def _path(a: str, b: str, one_way: bool) -> str:
    return f"{a}->{b}" if one_way else f"{a}-{b}"


async def _refuse(text: str) -> None:
    raise LabError(text)
