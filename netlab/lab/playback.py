"""A scenario's timeline as it is carried out: each moment at its time; a person may hold it, and step through it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any

from netlab.errors import LabError, NetlabError
from netlab.lab.effects import Effects
from netlab.lab.links import PERSON
from netlab.lab.parts import Parts
from netlab.lab.run_clock import RunClock
from netlab.timeline import DeployNode, Entry, MeshRoutes, MoveNode, Schedule, compile_timeline

_TOLD = 40  # entries that a status tells of


class Playback:
    """Plays one timeline on one lab. What cannot be carried out is told to ``on_problem``, and the rest goes on."""

    def __init__(self, parts: Parts, clock: RunClock, effects: Effects, on_problem: Callable[[str], None]) -> None:
        self._parts = parts
        self._clock = clock
        self._effects = effects
        self._on_problem = on_problem
        self._schedule = Schedule(compile_timeline(parts.scenario, parts.plan))
        self._routes: MeshRoutes | None = None
        self._retimed = asyncio.Event()

    @property
    def is_held(self) -> bool:
        """Whether the timeline stands still."""
        return self._schedule.is_held

    @property
    def is_over(self) -> bool:
        """Whether nothing comes any more."""
        return not self._schedule.coming

    @property
    def end_s(self) -> float:
        """When the run's duration is over, as far as is known: holds make it longer."""
        return self._parts.scenario.duration_s + self._schedule.standstill.total_s(self._clock.t_s or 0.0)

    def coming(self) -> list[dict[str, Any]]:
        """The next moments as plain values; ``at_s`` is run time, if nothing holds the timeline from now on."""
        now_s = self._clock.t_s or 0.0
        return [
            {"at_s": self._schedule.run_s(entry.at_s, now_s), "kind": entry.kind, "label": entry.label}
            for entry in self._schedule.coming[:_TOLD]
        ]

    async def play(self) -> None:
        """Carry the timeline out; returns at the end of the duration."""
        if self._parts.motion.contacts is not None and self._parts.plan.meshes:
            self._routes = MeshRoutes(self._parts.scenario, self._parts.plan)
        while True:
            for _, moment in groupby(self._schedule.take_due(self._clock.now_s), key=lambda entry: entry.at_s):
                await self._carry_out(list(moment))
            now_s = self._clock.now_s
            if not self.is_held and self.is_over and now_s >= self.end_s:
                return
            due_s = self._schedule.next_due_s(now_s)
            wait_s = None if self.is_held else (self.end_s if due_s is None else due_s) - now_s
            self._retimed.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._retimed.wait(), wait_s)

    def hold(self) -> None:
        """Let the timeline and all motion stand still. Raises LabError when they do already."""
        if self.is_held:
            raise LabError("the timeline stands still already")
        for standstill in (self._schedule.standstill, self._parts.motion.standstill):
            standstill.hold(PERSON, self._clock.now_s)
        self._retimed.set()

    def resume(self) -> None:
        """Let them go on. Raises LabError when they do."""
        if not self.is_held:
            raise LabError("the timeline is going on")
        for standstill in (self._schedule.standstill, self._parts.motion.standstill):
            standstill.release(PERSON, self._clock.now_s)
        self._retimed.set()

    async def step(self) -> list[Entry]:
        """Carry out the next moment now; returns its entries.

        Raises:
            LabError: Nothing comes any more.
        """
        if self.is_over:
            raise LabError("nothing comes any more")
        entries = self._schedule.step(self._clock.now_s)
        for entry in entries:
            if isinstance(entry.action, MoveNode | DeployNode) and entry.event is not None:
                self._parts.motion.forestall(entry.event)
        await self._carry_out(entries)
        self._retimed.set()
        return entries

    def drop_deployment(self, node: str) -> None:
        """Forget that a node is to be deployed, as somebody has done so."""
        for entry in self._schedule.coming:
            if isinstance(entry.action, DeployNode) and entry.action.node == node:
                self._schedule.drop(entry)

    async def _carry_out(self, moment: Sequence[Entry]) -> None:
        """Carry out the entries of one moment, which count together as to who has to find another way."""
        if self._routes is not None and self._parts.motion.contacts is not None:
            moment = self._routes.mark(moment, self._parts.motion.contacts())
        for entry in moment:
            await self._follow(entry)

    async def _follow(self, entry: Entry) -> None:
        at_s = min(self._schedule.run_s(entry.at_s, self._clock.now_s), self._clock.now_s)
        try:
            await self._effects.apply(
                entry.action, entry.kind, entry.label, at_s=at_s, event=entry.event, **_joins(entry)
            )
        except NetlabError as error:
            self._on_problem(f"{entry.label}: {error}")


def _joins(entry: Entry) -> dict[str, Any]:
    named = {"restores": entry.restores, "reroutes": entry.reroutes, "rejoins": entry.rejoins}
    return {key: value for key, value in named.items() if value}
