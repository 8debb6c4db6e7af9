"""Who is where at a time, and how the radios then lie to one another. Pure: the same values give the same answers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from netlab.world.geometry import Floats, Geometry, Indexes, Moment
from netlab.world.terrain import TunnelMap
from netlab.world.tracks import Track


class World:
    """Tracks of all nodes on a terrain, or in the open. Immutable."""

    def __init__(self, terrain: TunnelMap | None, tracks: Sequence[Track]) -> None:
        """``tracks`` in the order of the nodes."""
        self.terrain = terrain
        self.tracks = tuple(tracks)

    def moment(self, at_s: float) -> Moment:
        """Every node at a scenario time; what lies before 0 is as at 0."""
        states = [track.at(at_s) for track in self.tracks]
        return Moment(
            positions_m=np.array([state.position_m for state in states], dtype=np.float64).reshape(-1, 3),
            headings_deg=np.array([state.heading_deg for state in states]),
            speeds_mps=np.array([state.speed_mps for state in states]),
            travelled_m=np.array([state.travelled_m for state in states]),
            active=np.array([at_s >= track.active_from_s for track in self.tracks], dtype=np.bool_),
        )

    def geometry(self, moment: Moment, node_of_radio: Indexes) -> Geometry:
        """How radios lie to one another, ``node_of_radio[r]`` being the number of radio r's node."""
        nodes, places = np.unique(node_of_radio, return_inverse=True)
        positions_m = moment.positions_m[nodes]
        geometry = open_field(positions_m) if self.terrain is None else self.terrain.geometry(positions_m)
        if np.array_equal(places, np.arange(len(nodes))):
            return geometry
        grid = np.ix_(places, places)
        return Geometry(
            geometry.distance_m[grid],
            geometry.corners[grid],
            geometry.line_of_sight[grid],
            geometry.width_m[grid],
            geometry.height_m[grid],
            geometry.bearing_deg[grid],
            geometry.sections,
            geometry.shares[:, grid[0], grid[1]] if geometry.sections else geometry.shares,
        )


def open_field(positions_m: Floats) -> Geometry:
    """How positions (N, 3) lie to one another where nothing is between them."""
    apart = positions_m[None, :, :] - positions_m[:, None, :]
    shape = apart.shape[:2]
    return Geometry(
        distance_m=np.sqrt(np.einsum("ijk,ijk->ij", apart, apart)),
        corners=np.zeros(shape),
        line_of_sight=np.ones(shape, dtype=np.bool_),
        width_m=np.full(shape, np.nan),
        height_m=np.full(shape, np.nan),
        bearing_deg=np.degrees(np.arctan2(apart[:, :, 1], apart[:, :, 0])),
    )
