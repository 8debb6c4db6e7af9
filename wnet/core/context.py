"""What all parts of one node's mesh have in common."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass

from wnet.config import MeshConfig
from wnet.core.journal import Journal
from wnet.core.members import Member
from wnet.core.topology import TopologyGraph


@dataclass(frozen=True, slots=True)
class Context:
    """Settings and members stay as they are; graph and journal are kept by all parts.

    ``rng`` is for jitter and first sequence numbers.
    """

    config: MeshConfig
    members: Sequence[Member]
    graph: TopologyGraph
    journal: Journal
    rng: random.Random
