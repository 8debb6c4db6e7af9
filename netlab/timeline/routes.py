"""What the timeline means for nodes that a mesh joins: which cuts leave another path, which endings join again.

Theory. Two nodes of a mesh are joined when a chain of hops leads from one to the other, each hop up in both directions:
in range, not cut, carriers up. The entries of one moment count together: six cuts at once that sever two nodes are no
reason to reroute, and neither is a cut of what was not up. Only the ends of streams are asked about, since only they
can show an answer.

Who is in range is in the plan and in the entries, but for radios whose strengths change with places or by a measured
file: of those it is known at run time alone, who is in contact (``MeshRoutes.mark``).
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, permutations
from typing import TYPE_CHECKING

from netlab.scenario.mesh import components
from netlab.scenario.model import Scenario
from netlab.timeline.entries import Action, DeployNode, Entry, Pair, SetCarrier, SetOutage, SetPairs
from netlab.timeline.places import Places

if TYPE_CHECKING:
    from netlab.engines.base import LabPlan


def with_routes(entries: Sequence[Entry], scenario: Scenario, plan: LabPlan) -> tuple[Entry, ...]:
    """Mark the entries that concern streams over a mesh.

    The last cut of a moment gets ``reroutes``, the last ending ``rejoins``; ``restores`` of two nodes in a mesh goes,
    because it is the mesh that joins them. Where strengths change, nothing but that happens here.
    """
    if not plan.meshes:
        return tuple(entries)
    plain = [_plain(entry, scenario) for entry in entries]
    if _strengths_change(scenario):
        return tuple(plain)
    routes = MeshRoutes(scenario, plan)
    return tuple(entry for _, moment in groupby(plain, key=lambda e: e.at_s) for entry in routes.mark(list(moment)))


class MeshRoutes:
    """Marks moments of a timeline, one after another in the order of time."""

    def __init__(self, scenario: Scenario, plan: LabPlan) -> None:
        self._ends = dict.fromkeys(
            tuple(sorted((stream.source, stream.destination)))
            for stream in scenario.streams()
            if scenario.meshes[stream.source] is not None and scenario.reaches(stream.source, stream.destination)
        )
        self._state = _State(plan, carried_pairs(scenario, plan))

    def mark(self, moment: Sequence[Entry], contacts: Collection[Pair] | None = None) -> list[Entry]:
        """Mark the entries of one moment.

        Args:
            moment: In order.
            contacts: The pairs of radio ports that hear each other now; None: as the entries so far say.
        """
        if contacts is not None:
            self._state.hear(contacts)
        return _moment(list(moment), self._ends, self._state)


def _strengths_change(scenario: Scenario) -> bool:
    propagation = None if scenario.radio is None else scenario.radio.propagation
    return propagation is not None and (propagation.physics is not None or propagation.strengths_change)


def carried_pairs(scenario: Scenario, plan: LabPlan) -> dict[str, frozenset[Pair]]:
    """Of each node that is carried at the start, every pair of radio ports that it has a part in."""
    carried = [name for name, node in scenario.nodes.items() if node.carried_by is not None]
    places = Places(plan)
    return {name: places.pairs_of(name) for name in carried}


def _plain(entry: Entry, scenario: Scenario) -> Entry:
    a = entry.restores[0] if entry.restores else None
    return replace(entry, restores=None) if a is not None and scenario.meshes[a] is not None else entry


def _moment(entries: list[Entry], ends: Iterable[tuple[str, ...]], state: _State) -> list[Entry]:
    before, hops_before = state.parts(), state.hops()
    cuts: list[int] = []
    endings: list[int] = []
    for place, entry in enumerate(entries):
        (cuts if _cuts(entry.action) else endings).append(place)
        state.apply(entry.action)
    after = state.parts()
    joined = [(a, b) for a, b in ends if after[a] == after[b]]
    if cuts and hops_before - state.hops():
        reroutes = tuple((a, b) for a, b in joined if before[a] == before[b])
        entries[cuts[-1]] = replace(entries[cuts[-1]], reroutes=reroutes)
    if endings:
        rejoins = tuple((a, b) for a, b in joined if before[a] != before[b])
        entries[endings[-1]] = replace(entries[endings[-1]], rejoins=rejoins)
    return entries


def _cuts(action: Action) -> bool:
    match action:
        case SetOutage(active=active):
            return active
        case SetCarrier(up=up):
            return not up
        case SetPairs(changes):
            return None in changes.values()
    return False


class _State:
    """What is up, entry by entry."""

    def __init__(self, plan: LabPlan, carried: dict[str, frozenset[Pair]]) -> None:
        self._plan = plan
        members = {port for mesh in plan.meshes for port in mesh.ports}
        kinds = {mesh.node: mesh.kind for mesh in plan.meshes}
        self._in_range: dict[Pair, bool] = {
            (sender, receiver): (sender, receiver) in segment.pairs
            for segment in plan.segments
            for sender in segment.ports
            for receiver in segment.ports
            if sender != receiver
            and {sender, receiver} <= members
            and kinds[plan.ports[sender].node] is kinds[plan.ports[receiver].node]
        }
        self._out: frozenset[Pair] = frozenset()
        self._carried = carried
        self._unplugged: set[int] = set()
        self._radios = [pair for segment in plan.segments if segment.channel for pair in permutations(segment.ports, 2)]
        self._radios = [pair for pair in self._radios if pair in self._in_range]
        self._hops: frozenset[Pair] | None = None
        self._parts: Mapping[str, Hashable] = {}

    def apply(self, action: Action) -> None:
        match action:
            case SetOutage(pairs, active):
                self._out = self._out | pairs if active else self._out - pairs
            case DeployNode(node):
                self._carried.pop(node, None)
            case SetCarrier(ports, up):
                self._unplugged = self._unplugged - ports if up else self._unplugged | ports
            case SetPairs(changes):
                heard = {pair: impairment is not None for pair, impairment in changes.items()}
                news = {pair: now for pair, now in heard.items() if self._in_range.get(pair, now) is not now}
                if not news:  # most steps of a radio trace
                    return
                self._in_range |= news
        self._hops = None

    def hear(self, contacts: Collection[Pair]) -> None:
        """Radios in contact are in range, and all others are not."""
        now = {pair: pair in contacts for pair in self._radios}
        if now.items() - self._in_range.items():
            self._in_range |= now
            self._hops = None

    def hops(self) -> frozenset[Pair]:
        """Pairs of ports (the lower one first) that are up in both directions."""
        if self._hops is None:
            self._hops = frozenset((a, b) for a, b in self._in_range if a < b and self._up(a, b) and self._up(b, a))
            ports = self._plan.ports
            self._parts = components(self._plan.nodes, ((ports[a].node, ports[b].node) for a, b in self._hops))
        return self._hops

    def parts(self) -> Mapping[str, Hashable]:
        """Label the nodes by the part of a mesh that they are in now."""
        self.hops()
        return self._parts

    def _up(self, sender: int, receiver: int) -> bool:
        pair = (sender, receiver)
        carried = any(pair in pairs for pairs in self._carried.values())
        return self._in_range[pair] and not (carried or pair in self._out or self._unplugged & {sender, receiver})
