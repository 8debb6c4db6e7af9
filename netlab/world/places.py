"""Where positions lie in tunnels: the nearest centre line, the foot on it, and whether there is rock around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from netlab.world.geometry import Flags, Floats, Indexes

_SLACK_M = 0.01  # a position on the wall as people write it


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Positions seen from the centre lines nearest to them."""

    edges: Indexes  # (N,) the nearest edge
    feet_m: Floats  # (N, 3) the point on its centre line
    inside: Flags  # (N,) within its width and height
    gaps_m: Floats  # (N,) distance from the foot


class CentreLines:
    """Edges of a tunnel graph with the cross-section around each."""

    def __init__(self, starts_m: Floats, ends_m: Floats, widths_m: Floats, heights_m: Floats) -> None:
        self._starts_m = starts_m
        self._along = ends_m - starts_m
        self._squared = np.maximum(np.einsum("ek,ek->e", self._along, self._along), 1e-12)
        self._half_widths_m = widths_m / 2.0 + _SLACK_M
        self._heights_m = heights_m + _SLACK_M

    def places(self, positions_m: Floats) -> Places:
        """Find the place of each position (N, 3): on the nearest centre line that has it inside, else the nearest."""
        # One matrix (N, E) per axis: twice as fast as arrays of vectors.
        (ux, uy, uz), axes = self._along.T, (positions_m.T[:, :, None] - self._starts_m.T[:, None, :])
        shares = np.clip((axes[0] * ux + axes[1] * uy + axes[2] * uz) / self._squared, 0.0, 1.0)
        dx, dy, dz = axes[0] - shares * ux, axes[1] - shares * uy, axes[2] - shares * uz
        aside_squared = dx * dx + dy * dy
        gaps_m = np.sqrt(aside_squared + dz * dz)
        inside = (aside_squared <= self._half_widths_m**2) & (np.abs(dz) <= self._heights_m)
        edges = np.argmin(np.where(inside, gaps_m, gaps_m + 1e9), axis=1)
        rows = np.arange(len(positions_m))
        feet_m = self._starts_m[edges] + shares[rows, edges, None] * self._along[edges]
        return Places(edges, feet_m, inside[rows, edges], gaps_m[rows, edges])

    def floor(self, x_m: float, y_m: float) -> float:
        """Height of the floor at a place on the map: that of the nearest centre line, seen from above."""
        flat = self._along[:, :2]
        away = np.array([x_m, y_m]) - self._starts_m[:, :2]
        squared = np.maximum(np.einsum("ek,ek->e", flat, flat), 1e-12)
        shares = np.clip(np.einsum("ek,ek->e", away, flat) / squared, 0.0, 1.0)
        gaps = away - shares[:, None] * flat
        nearest = int(np.argmin(np.einsum("ek,ek->e", gaps, gaps)))
        return float(self._starts_m[nearest, 2] + shares[nearest] * self._along[nearest, 2])
