"""The words for tunnels: centre lines in metres, with width and height."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, model_validator

from netlab.scenario.base import Problems, StrictModel
from netlab.scenario.places import Position
from netlab.scenario.quantities import Metres
from netlab.scenario.walls import WallWords

if TYPE_CHECKING:
    from netlab.world.terrain import TunnelMap

MOST_POINTS = 1000  # the tables of all ways grow with the square
_MOST_CELLS = 32 * MOST_POINTS**2  # of the table of ways by kind of tunnel


class TunnelWords(StrictModel):
    """One tunnel: a name for messages and maps, the points of its centre line, its cross-section and walls."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    path: Annotated[tuple[Position, ...], Field(min_length=2)]
    width_m: Metres = Field(alias="width")
    height_m: Metres | None = Field(default=None, alias="height")
    material: WallWords | None = None

    @model_validator(mode="after")
    def _points_apart(self) -> Self:
        for index, (a, b) in enumerate(zip(self.path, self.path[1:], strict=False)):
            if _in_space(a) == _in_space(b):
                raise ValueError(f"path[{index + 1}] is where path[{index}] is; remove one")
        return self


class Terrain(StrictModel):
    """The tunnels in which all nodes are; they join where their centre lines meet."""

    tunnels: tuple[TunnelWords, ...]

    @model_validator(mode="after")
    def _distinct_and_few(self) -> Self:
        if not self.tunnels:
            raise ValueError("there is no tunnel; add one to tunnels, or remove terrain")
        names = [tunnel.name for tunnel in self.tunnels]
        twice = [f"two tunnels are called '{name}'; rename one" for name in sorted(set(names)) if names.count(name) > 1]
        points = sum(len(tunnel.path) for tunnel in self.tunnels)
        if points > MOST_POINTS:
            twice.append(f"the tunnels have {points:,} points; the most is {MOST_POINTS:,}")
        kinds = len({(tunnel.width_m, tunnel.height_m, tunnel.material) for tunnel in self.tunnels})
        if kinds * points**2 > _MOST_CELLS:
            twice.append(f"{points} points in {kinds} kinds of tunnels are too many; let widths or materials be equal")
        if twice:
            raise Problems(twice)
        return self

    @cached_property
    def tunnel_map(self) -> TunnelMap:
        """The tunnels with the tables of all ways; made once."""
        from netlab.world.terrain import TunnelMap  # NumPy, which a lab of wires does without
        from netlab.world.tunnels import Tunnel

        return TunnelMap(
            [
                Tunnel(
                    tunnel.name,
                    tuple(_in_space(point) for point in tunnel.path),
                    tunnel.width_m,
                    tunnel.width_m if tunnel.height_m is None else tunnel.height_m,
                    None if tunnel.material is None else tunnel.material.walls,
                )
                for tunnel in self.tunnels
            ]
        )


def _in_space(point: tuple[float, ...]) -> tuple[float, float, float]:
    return (point[0], point[1], point[2] if len(point) == 3 else 0.0)
