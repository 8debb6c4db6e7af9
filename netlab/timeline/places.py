"""Where on the plan two nodes meet: the pairs of ports of their wire and of their radios."""

from __future__ import annotations

from typing import TYPE_CHECKING

from netlab.medium.segments import SegmentKind
from netlab.scenario.events import PathEvent
from netlab.timeline.entries import Pair
from netlab.timeline.paths import Hop

if TYPE_CHECKING:
    from netlab.engines.base import LabPlan


class Places:
    """Finds ports by node names, once for a whole plan."""

    def __init__(self, plan: LabPlan) -> None:
        self._wires: dict[Hop, Pair] = {}
        self._radios: dict[str, int] = {}
        for segment in plan.segments:
            nodes = [plan.ports[port].node for port in segment.ports]
            if segment.kind is SegmentKind.WIRE:
                self._wires[nodes[0], nodes[1]] = (segment.ports[0], segment.ports[1])
                self._wires[nodes[1], nodes[0]] = (segment.ports[1], segment.ports[0])
            else:
                self._radios |= dict(zip(nodes, segment.ports, strict=True))

    def wire(self, hop: Hop) -> Pair | None:
        """The pair of ports of the wire from one node to the other, if there is one."""
        return self._wires.get(hop)

    def radio(self, hop: Hop) -> Pair | None:
        """The pair of radio ports from one node to the other, if both have one."""
        sender, receiver = (self._radios.get(name) for name in hop)
        return None if sender is None or receiver is None else (sender, receiver)

    def all_between(self, a: str, b: str) -> set[Pair]:
        """Every pair of ports that joins two nodes, both ways."""
        found = (place((x, y)) for place in (self.wire, self.radio) for x, y in ((a, b), (b, a)))
        return {pair for pair in found if pair is not None}

    def pairs_of(self, node: str) -> frozenset[Pair]:
        """Every pair of radio ports to and from a node."""
        others = [name for name in self._radios if name != node]
        found = (self.radio(hop) for other in others for hop in ((node, other), (other, node)))
        return frozenset(pair for pair in found if pair is not None)

    def meant(self, event: PathEvent) -> tuple[set[Pair], set[Pair]]:
        """The pairs of the wire and those of the radios that an event is about."""
        wire = {self.wire(hop) for hop in event.directions} if event.over != "radio" else set()
        radio = {self.radio(hop) for hop in event.directions} if event.over != "wire" else set()
        return {pair for pair in wire if pair is not None}, {pair for pair in radio if pair is not None}
