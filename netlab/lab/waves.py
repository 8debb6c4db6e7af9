"""How strongly the radios of a running lab hear each other as time goes on, handed to the engine tick by tick.

The link budget of who is where, for radios whose propagation model goes by positions; what a file says, for those of
measured tables (:mod:`netlab.lab.measured`). Everybody else's strength is what the scenario says.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from netlab.engines.base import LabPlan
from netlab.engines.plan import RADIO_PREFIX
from netlab.errors import LabError
from netlab.lab.contacts import ContactWatch
from netlab.lab.links import Links
from netlab.lab.measured import MeasuredWaves, WordsBetweenRows
from netlab.lab.motion import Motion
from netlab.lab.recording import Recording
from netlab.medium.segments import Segment
from netlab.scenario.model import Scenario
from netlab.world.budget import LinkBudget, RadioUnit
from netlab.world.propagation.model import PropagationModel
from netlab.world.tracks import Track
from netlab.world.world import World

#: The state of all pairs is recorded this often, in large teams that hear each other less often.
_RECORD_EVERY_S, _MOST_ROWS_PER_S = 0.5, 1000


Update = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class _Channel:
    segment: str
    budget: LinkBudget


class Waves:
    """The signal strengths of a lab's radios as its nodes move."""

    def __init__(self, scenario: Scenario, plan: LabPlan, links: Links, physics: PropagationModel) -> None:
        self._terrain = None if scenario.terrain is None else scenario.terrain.tunnel_map
        self._links = links
        self._channels = list(_channels(scenario, plan, physics))

    def update(self, at_s: float, tracks: Sequence[Track]) -> None:
        """Let everybody be where ``tracks`` (in the order of the nodes) says at a scenario time.

        Raises:
            LabError: The engine is gone.
        """
        world = World(self._terrain, tracks)
        moment = world.moment(at_s)
        for channel in self._channels:
            geometry = world.geometry(moment, channel.budget.node_of_radio)
            self._links.set_rssi(channel.segment, channel.budget.rssi_dbm(moment, geometry, at_s))


class _Follower:
    """Lets a scenario time take effect on the radios, and records what has become of them."""

    def __init__(
        self, updates: Sequence[Update], watch: ContactWatch | None, plan: LabPlan, links: Links, recording: Recording
    ) -> None:
        self._updates = updates
        self._watch = watch
        self._channels = [segment for segment in plan.segments if segment.channel is not None]
        self._links = links
        self._recording = recording
        self._due_s = 0.0

    def update(self, at_s: float) -> None:
        for update in self._updates:
            update(at_s)
        if self._watch is not None:
            self._watch.update([self._links.heard(segment) for segment in self._channels], at_s)

    def tick(self, at_s: float) -> None:
        with contextlib.suppress(LabError):  # the engine is gone, which the supervisor says itself
            self.update(at_s)
        if at_s >= self._due_s:
            rows = self._links.describe(heard_only=self._watch is not None)
            self._recording.links(rows)
            self._due_s = at_s + max(_RECORD_EVERY_S, len(rows) / _MOST_ROWS_PER_S)


def let_radios_follow(scenario: Scenario, plan: LabPlan, links: Links, motion: Motion, recording: Recording) -> LabPlan:
    """Set what radios hear of one another, now and at every tick of the motion, and record it.

    Returns:
        The plan with only those pairs that hear each other at the start: who can be discovered.
    """
    assert scenario.radio is not None
    propagation = scenario.radio.propagation
    watch = None
    if propagation.physics is not None or propagation.strengths_change:
        watch = ContactWatch(scenario, plan, [s for s in plan.segments if s.channel is not None], links, recording)
    follower = _Follower(list(_updates(scenario, plan, links, motion)), watch, plan, links, recording)
    follower.update(0.0)
    motion.on_tick = follower.tick
    physics = propagation.physics
    motion.always_ticks = physics is None or (physics.fading and physics.drift_hz > 0)
    if watch is None:
        return plan
    motion.contacts = watch.pairs
    motion.in_contact = lambda a, b: scenario.joined(a, b) != ("radio",) or watch.is_made(a, b)
    return _heard_plan(plan, links)


def _updates(scenario: Scenario, plan: LabPlan, links: Links, motion: Motion) -> Iterator[Update]:
    """What changes as time goes on: strengths by positions, or strengths and words by a measured file."""
    assert scenario.radio is not None
    propagation = scenario.radio.propagation
    if propagation.physics is not None:
        waves = Waves(scenario, plan, links, propagation.physics)
        yield lambda at_s: waves.update(at_s, motion.tracks)
    if propagation.strengths_change:
        yield MeasuredWaves(scenario, plan, links).update
    if propagation.interpolate:
        yield WordsBetweenRows(scenario, plan, links).update


def _heard_plan(plan: LabPlan, links: Links) -> LabPlan:
    heard = links.signals.is_heard
    segments = (
        replace(segment, pairs={pair: what for pair, what in segment.pairs.items() if heard(pair)})
        for segment in plan.segments
    )
    return replace(plan, segments=tuple(segments))


def _channels(scenario: Scenario, plan: LabPlan, physics: PropagationModel) -> list[_Channel]:
    return [
        _Channel(segment.name, LinkBudget(_units(scenario, plan, segment), physics, seed=plan.seed))
        for segment in plan.segments
        if segment.channel is not None
    ]


def _units(scenario: Scenario, plan: LabPlan, segment: Segment) -> list[RadioUnit]:
    """The segment's radios in the order of its ports."""
    units = []
    for port in (plan.ports[index] for index in segment.ports):
        radio = scenario.radios(port.node)[int(port.ifname.removeprefix(RADIO_PREFIX))]
        units.append(
            RadioUnit(
                name=f"{port.node} {port.ifname}",
                node=plan.nodes.index(port.node),
                frequency_hz=radio.frequency_hz,
                tx_power_dbm=radio.tx_power_dbm,
                antenna=radio.antenna.antenna(),
            )
        )
    return units
