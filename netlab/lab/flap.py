"""One link that goes down and up again by itself, as a person has asked for."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from netlab.engines.base import Pair
from netlab.lab.links import PERSON
from netlab.lab.parts import Parts
from netlab.lab.scenario_run import ScenarioRun
from netlab.timeline import Kind


@dataclass(frozen=True, slots=True)
class Flap:
    """What joins two nodes, as it flaps; a wire by its carrier, a radio by outages."""

    parts: Parts
    scenario_run: ScenarioRun
    a: str
    b: str
    pairs: frozenset[Pair]
    by_carrier: bool

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
        links, recording = self.parts.links, self.parts.recording
        holder = f"{PERSON} flap {self.a}-{self.b}"
        if self.by_carrier:
            links.set_carrier(holder, {port for pair in self.pairs for port in pair}, up=not down)
        else:
            links.set_outage(holder, set(self.pairs), active=down)
        kind, word = (Kind.FLAP_DOWN, "down") if down else (Kind.FLAP_UP, "up")
        restores = None if down else [self.a, self.b]
        label = f"flap {self.a}-{self.b} {word}"
        recording.timeline(kind, label, at_s=self.scenario_run.t_s, restores=restores)
        recording.links(links.describe())
