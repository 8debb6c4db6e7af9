"""Where on the plan two nodes meet: the pairs of ports of their wire and of their radios."""

from __future__ import annotations

from itertools import product
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
        self._radios: list[dict[str, list[int]]] = []  # of each radio segment, the ports of every node
        for segment in plan.segments:
            nodes = [plan.ports[port].node for port in segment.ports]
            if segment.kind is SegmentKind.WIRE:
                self._wires[nodes[0], nodes[1]] = (segment.ports[0], segment.ports[1])
                self._wires[nodes[1], nodes[0]] = (segment.ports[1], segment.ports[0])
            else:
                members: dict[str, list[int]] = {}
                for node, port in zip(nodes, segment.ports, strict=True):
                    members.setdefault(node, []).append(port)
                self._radios.append(members)

    def wire(self, hop: Hop) -> Pair | None:
        """The pair of ports of the wire from one node to the other, if there is one."""
        return self._wires.get(hop)

    def radios(self, hop: Hop) -> list[Pair]:
        """The pairs of radio ports from one node to the other: of each channel that both are on."""
        sender, receiver = hop
        return [
            pair for members in self._radios for pair in product(members.get(sender, ()), members.get(receiver, ()))
        ]

    def all_between(self, a: str, b: str) -> set[Pair]:
        """Every pair of ports that joins two nodes, both ways."""
        wires = {pair for hop in ((a, b), (b, a)) if (pair := self.wire(hop)) is not None}
        return wires.union(self.radios((a, b)), self.radios((b, a)))

    def pairs_of(self, node: str) -> frozenset[Pair]:
        """Every pair of radio ports to and from a node."""
        others = {name for members in self._radios for name in members} - {node}
        hops = [hop for other in others for hop in ((node, other), (other, node))]
        return frozenset(pair for hop in hops for pair in self.radios(hop))

    def meant(self, event: PathEvent) -> tuple[set[Pair], set[Pair]]:
        """The pairs of the wire and those of the radios that an event is about."""
        wire = {self.wire(hop) for hop in event.directions} if event.over != "radio" else set()
        radio = {pair for hop in event.directions for pair in self.radios(hop)} if event.over != "wire" else set()
        return {pair for pair in wire if pair is not None}, radio
