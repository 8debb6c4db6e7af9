"""`generate`: a regular topology written as one block, expanded into nodes and links before anything is checked."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from netlab.scenario.base import NodeName, StrictModel
from netlab.scenario.document import Document
from netlab.scenario.nodes import Node
from netlab.scenario.words import ReadText, Words

MAX_NODES = 2000
MAX_LINKS = 32_000
_SPACING_M = 10.0


class Generate(StrictModel):
    """``count`` nodes called ``name``1, ``name``2, ... joined in a ``shape`` by links alike."""

    shape: Literal["line", "star", "grid", "full"]
    count: Annotated[int, Field(ge=1, le=MAX_NODES)]
    name: NodeName = "n"
    node: Node = Node()
    link: Words = Words()

    @model_validator(mode="after")
    def _not_too_many_links(self) -> Self:
        links = self.count * (self.count - 1) // 2 if self.shape == "full" else 0
        if links > MAX_LINKS:
            raise ValueError(f"{self.count} nodes in full make {links:,} links; the most is {MAX_LINKS:,}")
        return self

    def names(self) -> list[str]:
        """The names of the generated nodes, in order."""
        return [f"{self.name}{number}" for number in range(1, self.count + 1)]

    def joined(self) -> Iterator[tuple[int, int]]:
        """The pairs of nodes (indices from 0) that a link joins."""
        everyone = range(self.count)
        if self.shape == "line":
            yield from ((index, index + 1) for index in everyone[:-1])
        elif self.shape == "star":
            yield from ((0, index) for index in everyone[1:])
        elif self.shape == "full":
            yield from ((a, b) for a in everyone for b in everyone[a + 1 :])
        else:
            yield from self._grid()

    def position(self, index: int) -> list[float]:
        """Where node ``index`` stands when the file does not say: metres, 10 m from its neighbours in line and grid."""
        if self.shape == "line":
            return [index * _SPACING_M, 0.0]
        if self.shape == "grid":
            row, column = divmod(index, self._columns)
            return [column * _SPACING_M, row * _SPACING_M]
        if self.shape == "star" and index == 0:
            return [0.0, 0.0]
        angle = 2 * math.pi * index / self.count
        radius = max(_SPACING_M, _SPACING_M * self.count / (2 * math.pi))
        return [round(radius * math.cos(angle), 3), round(radius * math.sin(angle), 3)]

    @property
    def _columns(self) -> int:
        return math.isqrt(self.count - 1) + 1

    def _grid(self) -> Iterator[tuple[int, int]]:
        columns = self._columns
        for index in range(self.count):
            if (index + 1) % columns and index + 1 < self.count:
                yield index, index + 1
            if index + columns < self.count:
                yield index, index + columns


def expand(document: Document, read: ReadText | None) -> bool:
    """Replace `generate` in ``document`` by what it stands for; False when it is wrong and was left for validation.

    A node that `nodes` names as well keeps its place in the shape and gets the template's keys that it lacks. Generated
    links come behind those of `links`.
    """
    block = document.data.get("generate")
    if block is None:
        return "generate" not in document.data
    nodes, links = document.data.get("nodes", {}), document.data.get("links", [])
    try:
        shape = Generate.model_validate(block, context=read)
    except ValidationError:
        return False
    if not isinstance(nodes, dict) or not isinstance(links, list):
        return False
    del document.data["generate"]
    document.data["nodes"] = _nodes(shape, block.get("node", {}), nodes)
    document.data["links"] = links + _links(shape, block.get("link", {}))
    document.templates |= {("nodes", name): ("generate", "node") for name in shape.names()}
    document.templates |= {("links", len(links) + k): ("generate", "link") for k in range(len(list(shape.joined())))}
    return True


def _nodes(shape: Generate, template: dict[str, Any], explicit: dict[str, Any]) -> dict[str, Any]:
    nodes: dict[str, Any] = {}
    for index, name in enumerate(shape.names()):
        own = explicit.get(name) or {}
        if isinstance(own, dict):
            own = template | own
            placed = any(key in own for key in ("waypoints", "follow", "carried_by", "motion"))
            own = own if placed else {"position": shape.position(index)} | own
        nodes[name] = own
    return nodes | {name: body for name, body in explicit.items() if name not in nodes}


def _links(shape: Generate, template: dict[str, Any]) -> list[dict[str, Any]]:
    names = shape.names()
    return [{"between": [names[a], names[b]], **template} for a, b in shape.joined()]
