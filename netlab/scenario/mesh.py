"""The `mesh` word and the settings of the meshes: what routes between the nodes, if anything does."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from netlab.medium.meshes import BabelOptions, BatmanOptions, FloodOptions, MeshKind, RoutingAlgorithm
from netlab.scenario.base import StrictModel, Switch, suggestion
from netlab.scenario.quantities import DURATION, Quantity, describe

MESHES = ("none", *MeshKind)
_BATMAN = ("batman", "batman_adv", "bat0", "batadv")

#: What a file may say; None (the key is absent) means the top level's, which is `none` by default.
MeshWord = Annotated[
    Literal["none", "batman-adv", "flood", "wnet", "babel"],
    BeforeValidator(lambda value: _mesh(value)),
    WithJsonSchema({"enum": list(MESHES)}),
]


def _mesh(value: object) -> object:
    if value in _BATMAN:
        raise ValueError(f"unknown mesh '{value}'; did you mean 'batman-adv'?")
    if value not in MESHES:
        raise ValueError(f"unknown mesh {describe(value)}; {suggestion(str(value), MESHES, 'known are')}")
    return value


def _algorithm(value: object) -> RoutingAlgorithm:
    name = str(value)
    known = {full.removeprefix(prefix): full for full in RoutingAlgorithm for prefix in ("", "BATMAN_")}
    if name not in known:
        raise ValueError(f"unknown routing algorithm {describe(value)}; known are {', '.join(RoutingAlgorithm)}")
    return known[name]


#: The kernel takes whole milliseconds from 40 ms, twice its own jitter (BATADV_JITTER in net/batman-adv/main.h).
Interval = Annotated[float, Quantity(DURATION, minimum=0.04, maximum=600.0)]


class BatmanSettings(StrictModel):
    """Settings of batman-adv, at top level or in a node (which wins); None leaves the lab's or the kernel's default."""

    routing_algorithm: (
        Annotated[RoutingAlgorithm, BeforeValidator(_algorithm), WithJsonSchema({"enum": list(RoutingAlgorithm)})]
        | None
    ) = None
    originator_interval_s: Interval | None = Field(default=None, alias="originator_interval")
    elp_interval_s: Interval | None = Field(default=None, alias="elp_interval")
    hop_penalty: Annotated[int, Field(ge=0, le=255)] | None = None
    bridge_loop_avoidance: Switch | None = None

    def laid_over(self, base: BatmanSettings) -> BatmanOptions:
        """These settings over ``base``, over the defaults."""
        return BatmanOptions(**{**base.model_dump(exclude_none=True), **self.model_dump(exclude_none=True)})


class FloodSettings(StrictModel):
    """Settings of the flood, at top level or in a node (which wins); None leaves the lab's or the default."""

    hop_limit: Annotated[int, Field(ge=1, le=255)] | None = None
    jitter_s: Annotated[float, Quantity(DURATION, minimum=0.0, maximum=1.0)] | None = Field(
        default=None, alias="jitter"
    )

    def laid_over(self, base: FloodSettings) -> FloodOptions:
        """These settings over ``base``, over the defaults."""
        return FloodOptions(**{**base.model_dump(exclude_none=True), **self.model_dump(exclude_none=True)})


class BabelSettings(StrictModel):
    """Settings of babeld, at top level or in a node (which wins); None leaves the lab's or the default."""

    hello_interval_s: Annotated[float, Quantity(DURATION, minimum=0.01, maximum=655.0)] | None = Field(
        default=None, alias="hello_interval"
    )
    wireless: Switch | None = None

    def laid_over(self, base: BabelSettings) -> BabelOptions:
        """These settings over ``base``, over the defaults."""
        return BabelOptions(**{**base.model_dump(exclude_none=True), **self.model_dump(exclude_none=True)})


def components(nodes: Iterable[str], joins: Iterable[tuple[str, str]]) -> dict[str, Hashable]:
    """Label nodes so that two have the same label if and only if a chain of ``joins`` leads from one to the other."""
    root = {name: name for name in nodes}

    def find(name: str) -> str:
        while root[name] != name:
            root[name] = root[root[name]]  # path halving keeps a line of thousands quick
            name = root[name]
        return name

    for a, b in joins:
        root[find(a)] = find(b)
    return {name: find(name) for name in root}


def same_mesh(kinds: Mapping[str, MeshKind | None], a: str, b: str) -> bool:
    """Whether two nodes understand each other's frames: both in the same kind of mesh, or both in none."""
    return kinds[a] is kinds[b]
