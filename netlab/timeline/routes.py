"""What the timeline means for nodes that a mesh joins: which cuts leave another path, which endings join again.

Theory. Two nodes of a mesh are joined when a chain of hops leads from one to the other, each hop up in both directions:
in range, not cut, carriers up. The entries of one moment count together: six cuts at once that sever two nodes are no
reason to reroute. Only the ends of streams are asked about, since only they can show an answer.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
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
    because it is the mesh that joins them.
    """
    meshed = [
        tuple(sorted((stream.source, stream.destination)))
        for stream in scenario.streams()
        if scenario.meshes[stream.source] is not None and scenario.reaches(stream.source, stream.destination)
    ]
    if not plan.meshes:
        return tuple(entries)
    state = _State(plan, carried_pairs(scenario, plan))
    marked: list[Entry] = []
    for _, moment in groupby(entries, key=lambda entry: entry.at_s):
        marked += _moment([_plain(entry, scenario) for entry in moment], dict.fromkeys(meshed), state)
    return tuple(marked)


def carried_pairs(scenario: Scenario, plan: LabPlan) -> dict[str, frozenset[Pair]]:
    """Of each node that is carried at the start, every pair of radio ports that it has a part in."""
    carried = [name for name, node in scenario.nodes.items() if node.carried_by is not None]
    places = Places(plan)
    return {name: places.pairs_of(name) for name in carried}


def _plain(entry: Entry, scenario: Scenario) -> Entry:
    a = entry.restores[0] if entry.restores else None
    return replace(entry, restores=None) if a is not None and scenario.meshes[a] is not None else entry


def _moment(entries: list[Entry], ends: Iterable[tuple[str, ...]], state: _State) -> list[Entry]:
    before = state.parts()
    cuts: list[int] = []
    endings: list[int] = []
    for place, entry in enumerate(entries):
        (cuts if _cuts(entry.action) else endings).append(place)
        state.apply(entry.action)
    after = state.parts()
    joined = [(a, b) for a, b in ends if after[a] == after[b]]
    if cuts:
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
        self._parts: Mapping[str, Hashable] | None = None

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
        self._parts = None

    def parts(self) -> Mapping[str, Hashable]:
        """Label the nodes by the part of a mesh that they are in now."""
        if self._parts is None:
            ports = self._plan.ports
            hops = ((ports[a].node, ports[b].node) for a, b in self._in_range if self._up(a, b) and self._up(b, a))
            self._parts = components(self._plan.nodes, hops)
        return self._parts

    def _up(self, sender: int, receiver: int) -> bool:
        pair = (sender, receiver)
        carried = any(pair in pairs for pairs in self._carried.values())
        return self._in_range[pair] and not (carried or pair in self._out or self._unplugged & {sender, receiver})
