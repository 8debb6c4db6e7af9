"""A simulated laser: a robot in a round room with a pillar, which drives in circles."""

from __future__ import annotations

import asyncio
import math

import rose
from rose.core.messages import Done
from rose.examples.messages import LaserScan, SetRate


class Laser(rose.Program):
    """Publishes scans; takes :class:`SetRate`."""

    class Settings(rose.Settings):
        """``beams`` around the circle, scans per second, and how fast it drives (0 stands still)."""

        rate_hz: float = 10.0
        beams: int = 720
        room_m: float = 8.0
        speed_mps: float = 0.5

    async def run(self) -> None:
        """Scan until cancelled."""
        self._rate_hz = self.settings.rate_hz
        self.service.on_command(SetRate, self._set_rate)
        loop = asyncio.get_running_loop()
        next_s, driven_m = loop.time(), 0.0
        while True:
            self.service.publish(scan(self.settings.beams, self.settings.room_m, driven_m))
            driven_m += self.settings.speed_mps / self._rate_hz
            next_s = max(next_s + 1.0 / self._rate_hz, loop.time() - 1.0)
            await asyncio.sleep(next_s - loop.time())

    async def _set_rate(self, command: SetRate) -> Done:
        if not 0.0 < command.rate_hz <= 100.0:
            raise ValueError(f"a rate of {command.rate_hz:g} Hz is impossible; it is above 0 and up to 100")
        self._rate_hz = command.rate_hz
        return Done()


def scan(beams: int, room_m: float, driven_m: float) -> LaserScan:
    """Return what the laser sees after it has driven that far on a circle of half the room's radius."""
    radius_m = room_m / 2
    along_rad = driven_m / radius_m
    x_m, y_m = radius_m * math.cos(along_rad), radius_m * math.sin(along_rad)
    heading_rad = along_rad + math.pi / 2
    step_rad = math.tau / beams
    ranges = [
        min(
            _to_circle(x_m, y_m, heading_rad - math.pi + beam * step_rad, 0.0, room_m),
            _to_circle(x_m, y_m, heading_rad - math.pi + beam * step_rad, radius_m / 2, 0.5),
        )
        for beam in range(beams)
    ]
    return LaserScan(-math.pi, step_rad, ranges, x_m, y_m, heading_rad)


def _to_circle(x_m: float, y_m: float, angle_rad: float, centre_x_m: float, radius_m: float) -> float:
    """Distance along a ray to a circle around (centre_x_m, 0); infinity if it misses."""
    dx, dy = x_m - centre_x_m, y_m
    along = dx * math.cos(angle_rad) + dy * math.sin(angle_rad)
    inside = along * along - (dx * dx + dy * dy - radius_m * radius_m)
    if inside < 0:
        return math.inf
    near, far = -along - math.sqrt(inside), -along + math.sqrt(inside)
    return near if near > 0 else (far if far > 0 else math.inf)
