"""The scenario file as a whole. Attributes carry SI units in their names; aliases are the keys of the file.

Build one with :func:`netlab.scenario.loader.load_scenario` or ``parse_scenario``: only these check references between
its parts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, field_validator

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

    def joined(self, a: str, b: str) -> tuple[Literal["wire", "radio"], ...]:
        """What joins two nodes directly: a wire, their radios (in range or not), both or nothing."""
        media: list[Literal["wire", "radio"]] = []
        if frozenset((a, b)) in self._wired:
            media.append("wire")
        if self.radio is not None and all(self.nodes[name].radio is None for name in (a, b)):
            media.append("radio")
        return tuple(media)

    @cached_property
    def _wired(self) -> frozenset[frozenset[str]]:
        return frozenset(frozenset(link.ends) for link in self.links)

    def destinations(self, traffic: Traffic) -> tuple[str, ...]:
        """Who gets a traffic entry's messages; `all` is every node joined to the source that runs udp_mesh."""
        if traffic.to != (ALL,):
            return traffic.to
        return tuple(
            name
            for name, node in self.nodes.items()
            if name != traffic.from_ and node.process("udp_mesh") and self.joined(traffic.from_, name)
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
