"""The lab's clockwork of motion: ticks at whole multiples, poses, moves, failures that are told."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from netlab.errors import LabError
from netlab.lab.motion import Motion
from netlab.lab.recording import Recording
from netlab.scenario import parse_scenario

WALK = "duration: 9s\nnodes: {a: {waypoints: [[0, 0], [90, 0]], speed: 1m/s}, b: {carried_by: a}}"


class Notes(Recording):
    """Keeps what would be recorded."""

    def __init__(self) -> None:
        super().__init__(None)
        self.messages: list[tuple[str, dict[str, Any]]] = []

    def message(self, topic: str, payload: dict[str, Any], t_ns: int) -> None:
        self.messages.append((topic, payload))


def motion(text: str = WALK) -> tuple[Motion, Notes]:
    notes = Notes()
    return Motion(parse_scenario(text), notes), notes


def test_the_map_and_where_everybody_begins_are_recorded_once() -> None:
    moving, notes = motion(WALK + "\nterrain: {tunnels: [{name: t, path: [[0, 0], [99, 0]], width: 3m}]}")
    moving.record_map()
    assert [topic for topic, _ in notes.messages] == ["/map", "/poses"]
    [tunnel] = notes.messages[0][1]["tunnels"]
    assert (tunnel["name"], tunnel["width_m"], tunnel["height_m"]) == ("t", 3, 3)
    assert notes.messages[1][1]["active"] == [True, False]


def test_a_lab_without_places_has_no_map() -> None:
    still, notes = motion("duration: 9s\nnodes: {a: , b: }")
    still.record_map()
    assert notes.messages == []


def test_ticks_come_at_whole_multiples_and_a_late_one_is_left_out() -> None:
    async def run() -> list[float]:
        moving, _notes = motion()
        ticks: list[float] = []
        done = asyncio.Event()

        def on_tick(at_s: float) -> None:
            ticks.append(at_s)
            if len(ticks) == 3:
                done.set()

        moving.on_tick = on_tick
        moving.begin(time.time_ns() - 1_020_000_000)  # it begins 1.02 s late
        await done.wait()
        moving.end()
        return ticks

    ticks = asyncio.run(run())
    assert ticks[0] >= 1.0 - 1e-9
    assert all(abs(at_s / 0.05 - round(at_s / 0.05)) < 1e-9 for at_s in ticks)


def test_what_breaks_in_a_tick_is_told() -> None:
    async def run() -> str:
        moving, _notes = motion()
        told: asyncio.Future[str] = asyncio.get_running_loop().create_future()

        def broken(at_s: float) -> None:
            raise ValueError(f"broken at {at_s:g}")

        moving.on_tick, moving.on_failure = broken, told.set_result
        moving.begin(time.time_ns())
        return await told

    assert asyncio.run(run()) == "nothing moves any more: ValueError('broken at 0.05')"


def test_a_person_moves_nodes_one_after_the_other() -> None:
    moving, notes = motion()
    moving.move("a", (5.0, 5.0), at_s=2.0)
    moving.move("a", (7.0, 5.0), at_s=3.0, speed_mps=1.0)
    assert moving.tracks[0].at(2.5).position_m == (5, 5, 0)
    assert moving.tracks[0].at(4.0).position_m == (6, 5, 0)
    assert notes.messages[0][1]["poses"][0]["position"] == {"x": 5, "y": 5, "z": 0}
    with pytest.raises(LabError, match="there is no node 'x'; nodes are a, b"):
        moving.move("x", (0.0, 0.0), at_s=4.0)
    with pytest.raises(LabError, match="'b' is still carried"):
        moving.move("b", (0.0, 0.0), at_s=4.0)


def test_while_the_timeline_is_held_nothing_moves_and_nothing_ticks() -> None:
    async def run() -> tuple[float, list[float], float]:
        moving, _notes = motion()
        ticks: list[float] = []
        done = asyncio.Event()
        begun_ns = time.time_ns()

        def on_tick(at_s: float) -> None:
            ticks.append(at_s)
            if len(ticks) == 3:
                done.set()

        moving.on_tick = on_tick
        moving.begin(begun_ns)
        await asyncio.wait_for(done.wait(), 10)
        moving.standstill.hold("person", (time.time_ns() - begun_ns) / 1e9)
        stood_s, count = moving.now_s(), len(ticks)
        await asyncio.sleep(0.2)
        moving.end()
        return stood_s, ticks[count:], moving.now_s()

    stood_s, ticks, after_s = asyncio.run(run())
    assert ticks == []
    assert after_s == pytest.approx(stood_s, abs=0.001)


def test_a_relay_is_dropped_where_its_carrier_is_now() -> None:
    async def run() -> tuple[float, ...]:
        moving, _notes = motion()
        moving.begin(time.time_ns() - 5_000_000_000)
        moving.deploy("b")
        with pytest.raises(LabError, match="on the ground already"):
            moving.deploy("b")
        moving.end()
        return moving.tracks[1].at(9.0).position_m

    assert asyncio.run(run())[0] == pytest.approx(5.0, abs=0.5)
