"""The scenario file as a whole. Attributes carry SI units in their names; aliases are the keys of the file.

Build one with :func:`netlab.scenario.loader.load_scenario` or ``parse_scenario``: only these check references between
its parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator

from netlab.scenario.base import NodeName, NotYet, StrictModel, not_yet
from netlab.scenario.events import Event
from netlab.scenario.expect import AnyExpectation
from netlab.scenario.generate import Generate
from netlab.scenario.links import Link, Wire, wires
from netlab.scenario.nodes import MeshSettings, Node
from netlab.scenario.quantities import PositiveSeconds
from netlab.scenario.radio import Radio
from netlab.scenario.traffic import ALL, Stream, Traffic

ENGINES = ("auto", "air", "netem")


class Scenario(StrictModel):
    """Everything that a scenario file says, with `generate` expanded."""

    name: Annotated[str, Field(min_length=1, max_length=100)]
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 1
    duration_s: PositiveSeconds = Field(alias="duration")
    engine: Annotated[
        Literal["auto", "air", "netem"],
        BeforeValidator(lambda value: not_yet(value, ENGINES, ("sim",), "engine")),
    ] = "auto"
    radio: Radio | None = None
    udp_mesh: MeshSettings = MeshSettings()
    nodes: dict[NodeName, Node] = Field(min_length=1)
    links: tuple[Link, ...] = ()
    traffic: tuple[Traffic, ...] = ()
    events: tuple[Event, ...] = ()
    expect: tuple[AnyExpectation, ...] = ()
    generate: Generate | None = None
    terrain: NotYet = None
    motion: NotYet = None
    wnet: NotYet = None
    rose: NotYet = None

    @field_validator("nodes", mode="before")
    @classmethod
    def _nodes_without_a_body(cls, value: object) -> object:
        return {name: body or {} for name, body in value.items()} if isinstance(value, dict) else value

    @property
    def radio_nodes(self) -> tuple[str, ...]:
        """The nodes with a radio, in order."""
        return tuple(name for name, node in self.nodes.items() if node.radio is None) if self.radio else ()

    def wires(self) -> tuple[Wire, ...]:
        """The wires that `links` makes, in the order of their first appearance."""
        return wires(self.links)

    def destinations(self, traffic: Traffic) -> tuple[str, ...]:
        """Who gets a traffic entry's messages; `all` is every other node that runs udp_mesh."""
        if traffic.to != (ALL,):
            return traffic.to
        return tuple(name for name, node in self.nodes.items() if name != traffic.from_ and node.process("udp_mesh"))

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
