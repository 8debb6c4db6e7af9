"""Who can talk to whom while radios go by positions: when two nodes come into contact and when they lose it.

Theory. Fading lets a weak pair be heard in one twentieth of a second and not in the next, so a contact is lost only
when the pair has not been heard for ``LOST_AFTER_S``, and made when it has been for ``MADE_AFTER_S`` (both directions
at once). Each is an act on the timeline, stamped with when that began: a contact that is made restores its two nodes,
and in a mesh joins the ends of streams that a path leads between again. What the timeline or a person holds down stays
down in any case.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from netlab.engines.base import LabPlan, Pair
from netlab.lab.links import Links
from netlab.lab.recording import Recording
from netlab.medium.segments import Segment, SegmentKind
from netlab.scenario.mesh import components, same_mesh
from netlab.scenario.model import Scenario
from netlab.timeline import Kind

Heard = NDArray[np.bool_]

LOST_AFTER_S = 1.0
MADE_AFTER_S = 0.2


class Contacts:
    """Debounced pairs of N radios; index [one, other], symmetric. Pure: the times are the caller's."""

    def __init__(self, count: int) -> None:
        self.made: Heard = np.zeros((count, count), dtype=np.bool_)
        self._contrary_since_s = np.full((count, count), np.nan)
        self._begun = False

    def update(self, heard: Heard, at_s: float) -> list[tuple[int, int, float]]:
        """Take note of who hears whom ``[sender, receiver]``; returns what changed: (one, other > one, since when).

        The first call sets the beginning, and nothing has changed then.
        """
        both = heard & heard.T
        if not self._begun:
            self._begun, self.made = True, both
            return []
        contrary = both != self.made
        since_s = np.where(contrary & np.isnan(self._contrary_since_s), at_s, self._contrary_since_s)
        self._contrary_since_s = np.where(contrary, since_s, np.nan)
        limit_s = np.where(self.made, LOST_AFTER_S, MADE_AFTER_S)
        changed = contrary & (at_s - since_s >= limit_s - 1e-9)
        if not changed.any():
            return []
        self.made = np.where(changed, both, self.made)
        self._contrary_since_s[changed] = np.nan
        return [(int(one), int(other), float(since_s[one, other])) for one, other in np.argwhere(np.triu(changed, 1))]


class ContactWatch:
    """Records what the contacts of all radios whose strengths change mean for the nodes that have them."""

    def __init__(
        self, scenario: Scenario, plan: LabPlan, segments: Sequence[Segment], links: Links, recording: Recording
    ) -> None:
        self._scenario = scenario
        self._links = links
        self._recording = recording
        self._ports = [segment.ports for segment in segments]
        self._contacts = [Contacts(len(segment.ports)) for segment in segments]
        self._wires = [other.ports for other in plan.segments if other.kind is SegmentKind.WIRE]
        self._names = [port.node for port in plan.ports]
        ends = (tuple(sorted((s.source, s.destination))) for s in scenario.streams() if scenario.meshes[s.source])
        self._meshed_ends = sorted({(a, b) for a, b in ends if same_mesh(scenario.meshes, a, b)})

    def update(self, heard: Sequence[Heard], at_s: float) -> None:
        """Take note of who hears whom ``[sender, receiver]``, segment by segment; record what has changed by that."""
        before = [contacts.made for contacts in self._contacts]
        changed = [
            (ports[one], ports[other], bool(contacts.made[one, other]), since_s)
            for ports, contacts, matrix in zip(self._ports, self._contacts, heard, strict=True)
            for one, other, since_s in contacts.update(matrix, at_s)
        ]
        if not changed:
            return
        joined = [self._joined(made) for made in (before, [contacts.made for contacts in self._contacts])]
        meant: dict[str, object] = {"reroutes": sorted(joined[0] & joined[1]), "rejoins": sorted(joined[1] - joined[0])}
        for one, other, made, since_s in changed:
            a, b = self._names[one], self._names[other]
            key = "rejoins" if made else "reroutes"
            plain = made and self._scenario.meshes[a] is None and self._is_free(one, other)
            marks = {"restores": [a, b] if plain else None, key: meant.pop(key, [])}
            label = f"{a} and {b} {'hear' if made else 'lose'} each other"
            self._recording.timeline(Kind.RADIO, label, at_s=since_s, ago_s=at_s - since_s, **marks)

    def is_made(self, a: str, b: str) -> bool:
        """Whether two nodes are in contact by these radios."""
        return any({self._names[one], self._names[other]} == {a, b} for one, other in self.pairs())

    def pairs(self) -> frozenset[Pair]:
        """The pairs of ports that are in contact, both ways."""
        hops = self._hops([contacts.made for contacts in self._contacts])
        return frozenset(pair for one, other in hops for pair in ((one, other), (other, one)))

    def _hops(self, made: Sequence[Heard]) -> list[Pair]:
        return [
            (ports[one], ports[other])
            for ports, matrix in zip(self._ports, made, strict=True)
            for one, other in np.argwhere(np.triu(matrix, 1)).tolist()
        ]

    def _joined(self, made: Sequence[Heard]) -> set[tuple[str, str]]:
        """The ends of streams between which a path of the mesh leads."""
        if not self._meshed_ends:
            return set()
        hops = [*self._hops(made), *((ports[0], ports[1]) for ports in self._wires)]
        named = ((self._names[a], self._names[b]) for a, b in hops if self._is_free(a, b))
        parts = components(self._scenario.nodes, (ab for ab in named if same_mesh(self._scenario.meshes, *ab)))
        return {(a, b) for a, b in self._meshed_ends if parts[a] == parts[b]}

    def _is_free(self, a: int, b: int) -> bool:
        return not (self._links.is_held((a, b)) or self._links.is_held((b, a)))
