"""How strongly the radios of a running lab hear each other: the link budget of who is where, handed to the engine.

Only for radios whose propagation model goes by positions; everybody else's strength is what the scenario says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from netlab.engines.base import LabPlan
from netlab.lab.links import Links
from netlab.medium.segments import Segment
from netlab.scenario.model import Scenario
from netlab.scenario.radio_physics import DEFAULT_FREQUENCY_HZ, RadioEnds
from netlab.world.budget import LinkBudget, RadioUnit
from netlab.world.propagation.model import PropagationModel
from netlab.world.tracks import Track
from netlab.world.world import World


@dataclass(frozen=True, slots=True)
class _Channel:
    segment: str
    budget: LinkBudget


class Waves:
    """The signal strengths of a lab's radios as its nodes move."""

    def __init__(self, scenario: Scenario, plan: LabPlan, links: Links) -> None:
        physics = None if scenario.radio is None else scenario.radio.propagation.physics
        self._terrain = None if scenario.terrain is None else scenario.terrain.tunnel_map
        self._links = links
        self._channels = [] if physics is None else list(_channels(scenario, plan, physics))
        #: Whether strengths change while nobody moves.
        self.never_rest = physics is not None and physics.fading and physics.drift_hz > 0

    @property
    def any(self) -> bool:
        """Whether any radio goes by positions."""
        return bool(self._channels)

    def audible_plan(self, plan: LabPlan) -> LabPlan:
        """The plan with only those pairs of such radios that hear each other now: who can be discovered."""
        heard = self._links.signals.is_heard
        segments = (
            replace(segment, pairs={pair: what for pair, what in segment.pairs.items() if heard(pair)})
            for segment in plan.segments
        )
        return replace(plan, segments=tuple(segments))

    def update(self, at_s: float, tracks: Sequence[Track]) -> None:
        """Let everybody be where ``tracks`` (in the order of the nodes) says at a scenario time.

        Raises:
            LabError: The engine is gone.
        """
        if not self._channels:
            return
        world = World(self._terrain, tracks)
        moment = world.moment(at_s)
        for channel in self._channels:
            geometry = world.geometry(moment, channel.budget.node_of_radio)
            self._links.set_rssi(channel.segment, channel.budget.rssi_dbm(moment, geometry, at_s))


def _channels(scenario: Scenario, plan: LabPlan, physics: PropagationModel) -> list[_Channel]:
    return [
        _Channel(segment.name, LinkBudget(_units(scenario, plan, segment), physics, seed=plan.seed))
        for segment in plan.segments
        if segment.channel is not None
    ]


def _units(scenario: Scenario, plan: LabPlan, segment: Segment) -> list[RadioUnit]:
    """The segment's radios in the order of its ports."""
    radio = scenario.radio
    assert radio is not None
    units = []
    for index in segment.ports:
        port = plan.ports[index]
        node = scenario.nodes[port.node]
        own = node.radio if isinstance(node.radio, RadioEnds) else RadioEnds()
        units.append(
            RadioUnit(
                name=f"{port.node} {port.ifname}",
                node=plan.nodes.index(port.node),
                frequency_hz=own.frequency_hz or radio.frequency_hz or DEFAULT_FREQUENCY_HZ,
                tx_power_dbm=radio.tx_power_dbm if own.tx_power_dbm is None else own.tx_power_dbm,
                antenna=(own.antenna or radio.antenna).antenna(),
            )
        )
    return units
