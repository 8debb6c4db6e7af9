"""`generate`: a regular topology written as one block, expanded into nodes and links before anything is checked."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from netlab.scenario.base import NodeName, StrictModel
from netlab.scenario.nodes import Node
from netlab.scenario.words import Words

MAX_NODES = 2000


class Generate(StrictModel):
    """``count`` nodes called ``name``1, ``name``2, ... joined in a ``shape`` by links alike."""

    shape: Literal["line", "star", "grid", "full"]
    count: Annotated[int, Field(ge=1, le=MAX_NODES)]
    name: NodeName = "n"
    node: Node = Node()
    link: Words = Words()
