"""Nodes in motion: where they are as the scenario's time goes on, and what depends on that.

Theory. Everybody's place is a function of script time (the scenario's time less the holds, see
:mod:`netlab.timeline.schedule`), so a tick that comes late, or not at all, changes nothing of where a node is at the
next one. Ticks are at whole multiples of ``TICK_S`` of script time; a late one is not made up for. Before t = 0 all
nodes are where they begin.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from netlab.capture.scene import Passage, Pose, map_message, poses_message
from netlab.errors import LabError
from netlab.lab.links import Links, carried
from netlab.scenario.events import Event
from netlab.scenario.model import Scenario
from netlab.scenario.motion import tracks
from netlab.timeline import carried_pairs
from netlab.timeline.schedule import Standstill
from netlab.world.motion import MotionError, Move

if TYPE_CHECKING:
    from netlab.engines.base import LabPlan, Pair
    from netlab.lab.recording import Recording

TICK_S = 0.05
_TICKS_PER_POSE = 2


class Motion:
    """Where the nodes of a running lab are. ``on_tick`` gets the scenario time at every tick."""

    def __init__(self, scenario: Scenario, recording: Recording) -> None:
        self._scenario = scenario
        self._recording = recording
        self._moves: tuple[Move, ...] = ()
        self.tracks = tracks(scenario)
        self.on_tick: Callable[[float], None] = lambda at_s: None
        #: Whether the radios of two nodes are in contact, as far as that goes by places.
        self.in_contact: Callable[[str, str], bool] = lambda _a, _b: True
        #: The pairs of radio ports in contact, where that changes with places or by a measured file.
        self.contacts: Callable[[], frozenset[Pair]] | None = None
        self._moves_at_all = any(len(set(track.points_m)) > 1 or track.active_from_s > 0 for track in self.tracks)
        #: Whether something else than places changes with time.
        self.always_ticks = False
        self.on_failure: Callable[[str], None] = lambda text: None
        #: Who holds all motion, by run time.
        self.standstill = Standstill()
        self._t0_ns: int | None = None
        self._task: asyncio.Task[None] | None = None

    @property
    def is_described(self) -> bool:
        """Whether the scenario says anything of places, so that a map of it means something."""
        nodes = self._scenario.nodes.values()
        return self._scenario.terrain is not None or any(
            "position" in n.model_fields_set or n.motion_key for n in nodes
        )

    def record_map(self) -> None:
        """Record the terrain, and where everybody begins."""
        if not self.is_described:
            return
        now_ns = time.time_ns()
        terrain = self._scenario.terrain
        if terrain is not None:
            passages = [Passage(t.name, t.path, t.width_m, t.height_m) for t in terrain.tunnel_map.tunnels]
            self._recording.message("/map", map_message(passages), now_ns)
        self._record_poses(0.0, now_ns)

    def begin(self, t0_ns: int) -> None:
        """Tick from t = 0 on, if anything changes with time."""
        self._t0_ns = t0_ns
        if self._task is None and (self._moves_at_all or self.always_ticks):
            self._task = asyncio.create_task(self._run(t0_ns))
            self._task.add_done_callback(self._ended)

    def end(self) -> None:
        """Tick no more."""
        if self._task is not None:
            self._task.cancel()

    def move(self, node: str, to_m: tuple[float, ...], *, at_s: float, speed_mps: float | None = None) -> None:
        """Put a node elsewhere, or send it there; before t = 0 it will be there then.

        Raises:
            LabError: Unknown node, it is still carried, or the place lies in the rock.
        """
        if node not in self._scenario.nodes:
            raise LabError(f"there is no node '{node}'; nodes are {', '.join(self._scenario.nodes)}")
        if at_s < self.tracks[list(self._scenario.nodes).index(node)].active_from_s:
            raise LabError(f"'{node}' is still carried; move who carries it")
        moves = (*self._moves, Move(at_s, node, to_m, speed_mps))
        try:
            self.tracks = tracks(self._scenario, moves)
        except MotionError as error:
            raise LabError(f"{error.node}: {error}") from None
        self._moves, self._moves_at_all = moves, True
        self.tick(at_s)
        if self._t0_ns is not None:
            self.begin(self._t0_ns)

    def now_s(self) -> float:
        """Script time, 0 before it begins."""
        return 0.0 if self._t0_ns is None else max(0.0, self._script_s(self._t0_ns))

    def place(self, node: str) -> tuple[float, ...]:
        """Where a node is now."""
        return self.tracks[list(self._scenario.nodes).index(node)].at(self.now_s()).position_m

    def deploy(self, node: str) -> None:
        """A carried node lies on the ground from now on, where it is.

        Raises:
            LabError: Nobody carries it (any more).
        """
        at_s = self.now_s()
        if self.tracks[list(self._scenario.nodes).index(node)].active_from_s <= at_s:
            raise LabError(f"'{node}' lies on the ground already")
        others = [event for event in self._scenario.events if event.deploy != node]
        self._replan([*others, Event.model_construct(at_s=at_s, deploy=node)], at_s)

    def forestall(self, index: int) -> None:
        """A move or a deployment of the scenario (its place in `events`) happens now and not at its time."""
        at_s = self.now_s()
        events = list(self._scenario.events)
        events[index] = events[index].model_copy(update={"at_s": at_s})
        self._replan(events, at_s)

    def _replan(self, events: Sequence[Event], at_s: float) -> None:
        self._scenario = self._scenario.model_copy(update={"events": tuple(events)})
        self.tracks, self._moves_at_all = tracks(self._scenario, self._moves), True
        self.tick(at_s)
        if self._t0_ns is not None:
            self.begin(self._t0_ns)

    def tick(self, at_s: float, *, poses: bool = True) -> None:
        """Let a scenario time take effect now."""
        self.on_tick(at_s)
        if poses:
            self._record_poses(at_s, time.time_ns())

    def _script_s(self, t0_ns: int) -> float:
        run_s = (time.time_ns() - t0_ns) / 1e9
        return run_s - self.standstill.total_s(run_s)

    def _ended(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            self.on_failure(f"nothing moves any more: {error!r}")

    async def _run(self, t0_ns: int) -> None:
        number = 0
        while True:
            reached = int(self.now_s() / TICK_S)
            number = max(number + 1, reached)
            at_s = number * TICK_S
            while (wait_s := at_s - self._script_s(t0_ns)) > 0:
                await asyncio.sleep(wait_s)
            self.tick(at_s, poses=self._moves_at_all and number % _TICKS_PER_POSE == 0)

    def _record_poses(self, at_s: float, now_ns: int) -> None:
        poses = []
        for node, track in zip(self._scenario.nodes, self.tracks, strict=True):
            state = track.at(at_s)
            poses.append(Pose(node, state.position_m, state.heading_deg, at_s >= track.active_from_s))
        self._recording.message("/poses", poses_message(poses, at_s), now_ns)


def set_in_motion(scenario: Scenario, plan: LabPlan, links: Links, recording: Recording) -> Motion:
    """Put everybody where it begins: carried nodes are off the air, and the map is recorded."""
    for node, pairs in carried_pairs(scenario, plan).items():
        links.set_outage(carried(node), set(pairs), active=True)
    motion = Motion(scenario, recording)
    motion.record_map()
    return motion
