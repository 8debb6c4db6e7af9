"""The scenario file as a whole. Attributes carry SI units in their names; aliases are the keys of the file.

Build one with :func:`netlab.scenario.loader.load_scenario` or ``parse_scenario``: only these check references between
its parts.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, field_validator

from netlab.medium.meshes import BabelOptions, BatmanOptions, FloodOptions, MeshKind
from netlab.scenario.base import NodeName, StrictModel, not_yet
from netlab.scenario.events import Event
from netlab.scenario.expect import AnyExpectation
from netlab.scenario.generate import Generate
from netlab.scenario.links import Link, Wire, wires
from netlab.scenario.mesh import BabelSettings, BatmanSettings, FloodSettings, MeshWord, components, same_mesh
from netlab.scenario.motion import MotionFile
from netlab.scenario.nodes import MeshSettings, Node
from netlab.scenario.quantities import PositiveSeconds
from netlab.scenario.radio import Radio
from netlab.scenario.radio_physics import RadioSettings
from netlab.scenario.rose import RoseSettings
from netlab.scenario.terrain import Terrain
from netlab.scenario.traffic import ALL, Stream, Traffic
from netlab.scenario.wnet import WnetSettings

ENGINES = ("auto", "air", "netem")


_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_. -]{0,99}")


def _scenario_name(value: str) -> str:
    if not _NAME.fullmatch(value):
        raise ValueError(f"'{value}' cannot name files; use letters, digits and _ . - (at most 100 characters)")
    return value


class Scenario(StrictModel):
    """Everything that a scenario file says, with `generate` expanded."""

    name: Annotated[str, AfterValidator(_scenario_name)]
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 1
    duration_s: PositiveSeconds = Field(alias="duration")
    engine: Annotated[
        Literal["auto", "air", "netem"],
        BeforeValidator(lambda value: not_yet(value, ENGINES, ("sim",), "engine")),
    ] = "auto"
    radio: Radio | None = None
    mesh: MeshWord = "none"
    batman_adv: BatmanSettings = BatmanSettings()
    flood: FloodSettings = FloodSettings()
    babel: BabelSettings = BabelSettings()
    wnet: WnetSettings = WnetSettings()
    udp_mesh: MeshSettings = MeshSettings()
    nodes: dict[NodeName, Node] = Field(min_length=1)
    links: tuple[Link, ...] = ()
    traffic: tuple[Traffic, ...] = ()
    events: tuple[Event, ...] = ()
    expect: tuple[AnyExpectation, ...] = ()
    generate: Generate | None = None
    terrain: Terrain | None = None
    motion: MotionFile | None = None
    rose: RoseSettings = RoseSettings()

    @field_validator("nodes", mode="before")
    @classmethod
    def _nodes_without_a_body(cls, value: object) -> object:
        return {name: body or {} for name, body in value.items()} if isinstance(value, dict) else value

    @property
    def radio_nodes(self) -> tuple[str, ...]:
        """The nodes with a radio, in order."""
        return tuple(name for name, node in self.nodes.items() if node.radio != "none") if self.radio else ()

    def radios(self, node: str) -> tuple[RadioSettings, ...]:
        """The radios of a node, in the order of their interfaces radio0, radio1, ..."""
        own = self.nodes[node].radio
        return () if self.radio is None or own == "none" else self.radio.settings(own)

    @cached_property
    def _frequencies_hz(self) -> Mapping[str, frozenset[float]]:
        return {name: frozenset(radio.frequency_hz for radio in self.radios(name)) for name in self.nodes}

    @property
    def at_rest(self) -> tuple[str, ...]:
        """The nodes that take part from the start, in order: all but those that are carried."""
        return tuple(name for name, node in self.nodes.items() if node.carried_by is None)

    @property
    def holds(self) -> tuple[tuple[float, float], ...]:
        """When motion stands still: (from, for) in seconds, sorted and apart from one another."""
        spans: list[tuple[float, float]] = []
        for from_s, for_s in sorted((e.at_s, e.hold_s) for e in self.events if e.hold_s is not None):
            if spans and from_s <= sum(spans[-1]):
                last_s = spans.pop()
                from_s, for_s = last_s[0], max(sum(last_s), from_s + for_s) - last_s[0]
            spans.append((from_s, for_s))
        return tuple(spans)

    def wires(self) -> tuple[Wire, ...]:
        """The wires that `links` makes, in the order of their first appearance."""
        return wires(self.links)

    def joined(self, a: str, b: str) -> tuple[Literal["wire", "radio"], ...]:
        """What joins two nodes directly: a wire, their radios (in range or not), both or nothing."""
        media: list[Literal["wire", "radio"]] = []
        if frozenset((a, b)) in self._wired:
            media.append("wire")
        if self._frequencies_hz[a] & self._frequencies_hz[b]:
            media.append("radio")
        return tuple(media)

    @cached_property
    def _wired(self) -> frozenset[frozenset[str]]:
        return frozenset(frozenset(link.ends) for link in self.links)

    @cached_property
    def meshes(self) -> Mapping[str, MeshKind | None]:
        """The kind of mesh of every node; None is without."""
        words = {name: self.mesh if node.mesh is None else node.mesh for name, node in self.nodes.items()}
        return {name: None if word == "none" else MeshKind(word) for name, word in words.items()}

    def reaches(self, a: str, b: str) -> bool:
        """Whether messages can go between two nodes while nothing is cut: directly, bridged, or routed by their mesh.

        Radios count as in range, as in :meth:`joined`.
        """
        if not same_mesh(self.meshes, a, b):
            return False
        if self.meshes[a] is not None:
            return self._mesh_parts[a] == self._mesh_parts[b]
        return bool(self.joined(a, b)) or any(self.bridges(x, a, b) for x in self.bridge_nodes)

    @cached_property
    def bridge_nodes(self) -> tuple[str, ...]:
        """The nodes whose udp_mesh passes on between its carriers."""
        names = (name for name, node in self.nodes.items() if node.process("udp_mesh") and self.meshes[name] is None)
        return tuple(name for name in names if self.mesh_settings(name).get("bridge"))

    def bridges(self, bridge: str, a: str, b: str) -> bool:
        """Whether a bridge has two nodes on different media: two wires, a wire and a radio, or two channels."""
        media = self.joined(a, bridge), self.joined(bridge, b)
        channels = self._frequencies_hz[bridge] & (self._frequencies_hz[a] | self._frequencies_hz[b])
        has_two = any("wire" in joined for joined in media) or len(channels) > 1
        return bridge not in (a, b) and all(media) and has_two

    @cached_property
    def _mesh_parts(self) -> Mapping[str, Hashable]:
        joins = [link.ends for link in self.links if set(link.ends) <= self.nodes.keys()]
        on_air: dict[tuple[MeshKind | None, float], str] = {}  # anybody of that mesh on that frequency
        joins += [
            (on_air.setdefault((self.meshes[name], frequency_hz), name), name)
            for name in self.radio_nodes
            for frequency_hz in self._frequencies_hz[name]
        ]
        return components(self.nodes, (ends for ends in joins if same_mesh(self.meshes, *ends)))

    def batman_options(self, node: str) -> BatmanOptions:
        """batman-adv's settings in ``node``: the top-level block, overlaid by the node's own."""
        return (self.nodes[node].batman_adv or BatmanSettings()).laid_over(self.batman_adv)

    def flood_options(self, node: str) -> FloodOptions:
        """The flood's settings in ``node``: the top-level block, overlaid by the node's own."""
        return (self.nodes[node].flood or FloodSettings()).laid_over(self.flood)

    def babel_options(self, node: str) -> BabelOptions:
        """babeld's settings in ``node``: the top-level block, overlaid by the node's own."""
        return (self.nodes[node].babel or BabelSettings()).laid_over(self.babel)

    def wnet_settings(self, node: str) -> dict[str, Any]:
        """The mesh's table in the wnet daemon's file in ``node``: the top-level block, overlaid by the node's own."""
        return (self.nodes[node].wnet or WnetSettings()).laid_over(self.wnet)

    def rose_file(self, node: str, addresses: dict[str, str]) -> dict[str, Any]:
        """The file of the Service Manager in ``node``; ``addresses`` by node."""
        return (self.nodes[node].rose or RoseSettings()).host_file(self.rose, addresses[node], addresses)

    def process_names(self, node: str) -> tuple[str, ...]:
        """What runs in a node by name: its own processes, and that which is its mesh."""
        own = tuple(process.name for process in self.nodes[node].processes)
        mesh = self.meshes[node]
        return own if mesh is None or mesh.process is None else (*own, mesh.process)

    def destinations(self, traffic: Traffic) -> tuple[str, ...]:
        """Who gets a traffic entry's messages; `all` is every node in its reach that runs udp_mesh."""
        if traffic.to != (ALL,):
            return traffic.to
        return tuple(
            name
            for name, node in self.nodes.items()
            if name != traffic.from_ and node.process("udp_mesh") and self.reaches(traffic.from_, name)
        )

    def streams(self) -> tuple[Stream, ...]:
        """One stream per traffic entry and destination, numbered in the order of the file."""
        return tuple(
            Stream(index, entry, item.from_, destination, item.topic, item.priority)
            for index, (entry, item, destination) in enumerate(self._flows())
        )

    def mesh_settings(self, node: str) -> dict[str, Any]:
        """The udp_mesh daemon's configuration in ``node``: the top-level block, overlaid by the node's own."""
        own = self.nodes[node].udp_mesh
        return self.udp_mesh.daemon_config() | (own.daemon_config() if own else {})

    def _flows(self) -> Iterator[tuple[int, Traffic, str]]:
        for entry, item in enumerate(self.traffic):
            for destination in self.destinations(item):
                yield entry, item, destination
