"""What the example services say to each other."""

from __future__ import annotations

import math

from rose.core.types import Message, message


@message("example/laser_scan", sliced="ranges_m")
class LaserScan(Message, array_like=True, frozen=True):
    """One turn of a laser. ``ranges_m``: distance by beam, from ``first_rad`` on; NaN where nothing is known."""

    first_rad: float
    step_rad: float
    ranges_m: list[float]
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0

    def angle_rad(self, beam: int) -> float:
        """Return the direction of a beam, counter-clockwise from straight ahead."""
        return math.remainder(self.first_rad + beam * self.step_rad, math.tau)


@message("example/set_rate")
class SetRate(Message, array_like=True, frozen=True):
    """To the laser: turn so often per second, above 0 and up to 100."""

    rate_hz: float


@message("example/obstacle")
class Obstacle(Message, array_like=True, frozen=True):
    """The nearest thing ahead. ``must_stop``: it is too near, or the laser cannot be trusted."""

    must_stop: bool
    distance_m: float
    why: str


@message("example/map_state")
class MapState(Message, array_like=True, frozen=True):
    """How much of the world a map has seen: cells by state, and the part of the last scan that was missing."""

    occupied_cells: int
    free_cells: int
    missing_ratio: float
