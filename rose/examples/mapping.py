"""Mapping: enters scans into a grid. What is missing of a scan costs nothing but its own beams."""

from __future__ import annotations

import math

import rose
from rose.examples.messages import LaserScan, MapState

Cell = tuple[int, int]


class Mapping(rose.Program):
    """Publishes :class:`MapState` after every scan."""

    class Settings(rose.Settings):
        """``laser``: its service id; ``cell_m``: the grid's width."""

        laser: str
        cell_m: float = 0.25

    async def run(self) -> None:
        """Map until cancelled."""
        self.occupied: set[Cell] = set()
        self.free: set[Cell] = set()
        scans = self.service.subscribe(self.settings.laser, LaserScan)
        try:
            async for sample in scans:
                assert isinstance(sample.message, LaserScan)
                self.enter(sample.message)
                state = MapState(len(self.occupied), len(self.free), 1.0 - sample.completeness)
                self.service.publish(state)
        finally:
            self.service.unsubscribe(scans.sender)

    def enter(self, scan: LaserScan) -> None:
        """Mark the cell that each beam ends in, and the one halfway as free."""
        for beam, distance_m in enumerate(scan.ranges_m):
            if not math.isfinite(distance_m):
                continue
            angle_rad = scan.heading_rad + scan.angle_rad(beam)
            end = self._cell(scan, angle_rad, distance_m)
            self.occupied.add(end)
            self.free.discard(end)
            halfway = self._cell(scan, angle_rad, distance_m / 2)
            if halfway not in self.occupied:
                self.free.add(halfway)

    def _cell(self, scan: LaserScan, angle_rad: float, distance_m: float) -> Cell:
        size_m = self.settings.cell_m
        return (
            math.floor((scan.x_m + distance_m * math.cos(angle_rad)) / size_m),
            math.floor((scan.y_m + distance_m * math.sin(angle_rad)) / size_m),
        )
