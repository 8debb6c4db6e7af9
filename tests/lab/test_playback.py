"""The timeline as it is carried out: at its times, held, stepped; without a lab."""

from __future__ import annotations

import asyncio
import time
from types import SimpleNamespace
from typing import Any, cast

import pytest

from netlab.engines.plan import compile_plan
from netlab.errors import LabError
from netlab.lab.effects import Effects
from netlab.lab.parts import Parts
from netlab.lab.playback import Playback
from netlab.lab.run_clock import RunClock
from netlab.scenario import parse_scenario
from netlab.timeline import Action
from netlab.timeline.schedule import Standstill

TWO_CUTS = """
duration: 0.4s
nodes: {a: , b: }
links: [{between: [a, b]}]
events:
  - {at: 0.1s, outage: {between: [a, b], for: 0.1s}}
"""
LATER = TWO_CUTS.replace("at: 0.1s", "at: 60s").replace("duration: 0.4s", "duration: 90s")


class Applied:
    """Effects that note what they are asked for; ``broken`` labels fail."""

    def __init__(self, broken: str = "") -> None:
        self.labels: list[str] = []
        self.broken = broken

    async def apply(self, action: Action, kind: str, label: str, **_more: Any) -> None:
        if label == self.broken:
            raise LabError("no")
        self.labels.append(label)


def playback(text: str, effects: Applied, problems: list[str]) -> tuple[Playback, RunClock]:
    scenario = parse_scenario(text)
    motion = SimpleNamespace(standstill=Standstill(), contacts=None)
    parts = SimpleNamespace(scenario=scenario, plan=compile_plan(scenario), motion=motion)
    clock = RunClock()
    clock.t0_ns = time.time_ns()
    return Playback(cast(Parts, parts), clock, cast(Effects, effects), problems.append), clock


def test_all_is_done_in_order_and_the_duration_is_lived_out() -> None:
    async def run() -> tuple[list[str], float]:
        effects = Applied()
        playing, clock = playback(TWO_CUTS, effects, [])
        assert [row["at_s"] for row in playing.coming()] == pytest.approx([0.1, 0.2])
        await asyncio.wait_for(playing.play(), 20)
        return effects.labels, clock.now_s

    labels, ended_s = asyncio.run(run())
    assert labels == ["outage a-b begins", "outage a-b ends"]
    assert ended_s >= 0.4


def test_what_cannot_be_done_is_told_and_the_rest_goes_on() -> None:
    async def run() -> None:
        effects, problems = Applied(broken="outage a-b begins"), list[str]()
        playing, _clock = playback(TWO_CUTS, effects, problems)
        await asyncio.wait_for(playing.play(), 20)
        assert effects.labels == ["outage a-b ends"]
        assert problems == ["outage a-b begins: no"]

    asyncio.run(run())


def test_a_hold_makes_the_run_longer_and_stops_nothing_twice() -> None:
    async def run() -> None:
        effects = Applied()
        playing, clock = playback(TWO_CUTS, effects, [])
        playing.hold()
        with pytest.raises(LabError, match="stands still already"):
            playing.hold()
        task = asyncio.create_task(playing.play())
        await clock.sleep_until(0.5)
        assert effects.labels == []
        playing.resume()
        with pytest.raises(LabError, match="is going on"):
            playing.resume()
        await asyncio.wait_for(task, 20)
        assert effects.labels == ["outage a-b begins", "outage a-b ends"]
        assert clock.now_s >= 0.9

    asyncio.run(run())


def test_a_step_takes_the_next_moment_early() -> None:
    async def run() -> None:
        effects = Applied()
        playing, _clock = playback(LATER, effects, [])
        assert [entry.label for entry in await playing.step()] == ["outage a-b begins"]
        await playing.step()
        assert effects.labels == ["outage a-b begins", "outage a-b ends"]
        assert playing.is_over
        with pytest.raises(LabError, match="nothing comes any more"):
            await playing.step()

    asyncio.run(run())
