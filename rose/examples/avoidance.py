"""Collision avoidance: says stop when something is near ahead, and also when the laser has been silent for too long."""

from __future__ import annotations

import asyncio
import math

import rose
from rose.core.buffers import Deadline, Freshness
from rose.examples.messages import LaserScan, Obstacle


class Avoidance(rose.Program):
    """Publishes :class:`Obstacle` for every scan, and while there are none."""

    class Settings(rose.Settings):
        """``laser``: its service id. ``silent_s``: how long without scans before the robot must stop."""

        laser: str
        stop_m: float = 1.0
        ahead_rad: float = 0.5
        silent_s: float = 0.5

    async def run(self) -> None:
        """Watch until cancelled."""
        scans = self.service.subscribe(self.settings.laser, LaserScan, partial_after_s=0.02)
        deadline = Deadline(self.settings.silent_s)
        loop = asyncio.get_running_loop()
        try:
            while True:
                sample = await scans.receive(self.settings.silent_s)
                if sample is not None:
                    deadline.seen(now=loop.time())
                    assert isinstance(sample.message, LaserScan)
                    self.service.publish(self.judge(sample.message))
                elif deadline.state(now=loop.time()) is not Freshness.FRESH:
                    self.service.publish(Obstacle(True, math.nan, "the laser is silent"))
        finally:
            self.service.unsubscribe(scans.sender)

    def judge(self, scan: LaserScan) -> Obstacle:
        """Say how near the nearest thing ahead is. A beam ahead that is missing counts as a wall."""
        ahead = [
            distance
            for beam, distance in enumerate(scan.ranges_m)
            if abs(scan.angle_rad(beam)) <= self.settings.ahead_rad
        ]
        if not ahead or any(math.isnan(distance) for distance in ahead):
            return Obstacle(True, math.nan, "a part of the scan ahead is missing")
        nearest_m = min(ahead)
        return Obstacle(nearest_m < self.settings.stop_m, nearest_m, "")
