"""Where nodes are at one moment, and how their radios lie to one another. Values only; index [from, to]."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from netlab.world.walls import Section

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indexes = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """Every node at one time, in the order of the scenario.

    ``headings_deg`` count counter-clockwise from the x axis: the direction of travel, kept while a node stands.
    ``travelled_m`` is the length of the path since the start, without jumps. A node that is not ``active`` is still
    carried: its position is its carrier's, and it takes no part in anything.
    """

    positions_m: Floats  # (N, 3)
    headings_deg: Floats  # (N,)
    speeds_mps: Floats  # (N,)
    travelled_m: Floats  # (N,)
    active: Flags  # (N,)


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """How N radios lie to one another; all arrays are (N, N), and symmetric but for the bearings.

    ``distance_m`` is the length of the shortest way along the tunnels, never less than the straight line; inf where no
    way leads. ``corners`` counts the turns on that way: each turn of 20 degrees or more as its angle over 90 degrees,
    at most 1; 0 in line of sight. ``width_m`` and ``height_m`` are those of the narrowest tunnel on the way, nan
    without terrain. ``bearing_deg[i, j]`` is the direction in which the radiation of i for j leaves, counter-clockwise
    from the x axis: straight in line of sight, else along the tunnel at i. Without terrain all is in sight.

    ``shares[k]`` is which part of the way lies in tunnels like ``sections[k]``, summing up to 1; without terrain there
    are none.
    """

    distance_m: Floats
    corners: Floats
    line_of_sight: Flags
    width_m: Floats
    height_m: Floats
    bearing_deg: Floats
    sections: tuple[Section, ...] = ()
    shares: Floats = field(default_factory=lambda: np.empty((0, 0, 0)))  # (sections, N, N)
