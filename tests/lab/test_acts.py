"""Acts and their inverses: what is undone, and in which order; without a lab."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from netlab.errors import LabError
from netlab.lab.acts import Acts
from netlab.lab.parts import Parts
from netlab.lab.process import Process, ProcessSpec, State
from netlab.lab.recording import Recording
from netlab.lab.scenario_run import ScenarioRun


class Places:
    """A motion that puts nodes elsewhere."""

    def __init__(self) -> None:
        self.of = {"a": (0.0, 0.0), "b": (1.0, 1.0)}

    def place(self, node: str) -> tuple[float, ...]:
        return self.of[node]

    def now_s(self) -> float:
        return 1.0

    def move(self, node: str, to_m: tuple[float, float], *, at_s: float, speed_mps: float | None) -> None:
        self.of[node] = to_m


class OneProcess:
    """A process that ends when it is told to, and starts when ``may_start`` is set."""

    def __init__(self) -> None:
        self.process = Process(ProcessSpec("a", "daemon", ("daemon",), waits_for_ready=True), State.READY)
        self.may_start = asyncio.Event()

    def get(self, node: str, name: str) -> Process:
        return self.process

    def stop(self, process: Process, signum: int) -> None:
        process.state = State.EXITED

    def start(self, spec: ProcessSpec) -> Process:
        async def become_ready() -> None:
            await self.may_start.wait()
            self.process.state = State.READY
            self.process.changed.set()

        self.process.state = State.STARTING
        self.task = asyncio.create_task(become_ready())
        return self.process


def acts_on(motion: Places, processes: OneProcess) -> Acts:
    plan = SimpleNamespace(nodes=("a", "b"))
    parts = SimpleNamespace(plan=plan, motion=motion, processes=processes, recording=Recording(None))
    return Acts(cast(Parts, parts), cast(ScenarioRun, SimpleNamespace(t_s=1.0)))


def move(node: str, x: float) -> dict[str, Any]:
    return {"do": "move", "node": node, "to": [x, 0.0]}


def test_undo_takes_back_one_act_after_the_other_and_is_none_itself() -> None:
    async def run() -> None:
        motion = Places()
        acts = acts_on(motion, OneProcess())
        await acts.do(move("a", 5.0))
        await acts.do(move("b", 7.0))
        assert acts.next_undo == "move b to [7, 0]"
        assert await acts.do({"do": "undo"}) == {"ok": True, "label": "move b to [7, 0]"}
        assert motion.of == {"a": (5.0, 0.0), "b": (1.0, 1.0)}
        await acts.do({"do": "undo"})
        assert motion.of == {"a": (0.0, 0.0), "b": (1.0, 1.0)}
        with pytest.raises(LabError, match="there is nothing to undo"):
            await acts.do({"do": "undo"})

    asyncio.run(run())


def test_what_is_done_while_an_undo_waits_can_be_undone_too() -> None:
    async def run() -> None:
        processes = OneProcess()
        acts = acts_on(Places(), processes)
        await acts.do({"do": "kill", "node": "a", "process": "daemon"})
        undoing = asyncio.create_task(acts.do({"do": "undo"}))  # it waits until the daemon is ready again
        await asyncio.sleep(0)
        await acts.do(move("b", 7.0))
        processes.may_start.set()
        await undoing
        assert processes.process.state is State.READY
        assert acts.next_undo == "move b to [7, 0]"

    asyncio.run(run())


def test_a_mark_stands_where_the_key_was_pressed(monkeypatch: pytest.MonkeyPatch) -> None:
    rows: list[dict[str, Any]] = []
    monkeypatch.setattr(Recording, "timeline", lambda _self, kind, label, **more: rows.append({"kind": kind, **more}))
    acts = acts_on(Places(), OneProcess())
    asyncio.run(acts.do({"do": "mark", "text": "here", "ago_s": 0.75}))
    [row] = rows
    assert (row["kind"], row["at_s"], row["ago_s"], row["act"]) == ("mark", 0.25, 0.75, {"do": "mark", "text": "here"})


def test_what_is_no_act_is_left_to_others() -> None:
    async def run() -> None:
        assert await acts_on(Places(), OneProcess()).do({"do": "status"}) is None

    asyncio.run(run())
