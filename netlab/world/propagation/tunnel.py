"""A tunnel: free space until it acts as a waveguide, then slow decay; a loss at every corner.

Theory. Near the sender a tunnel's walls do not matter and the loss is that of free space. Where the first Fresnel zone
fills the cross-section, at d_bp = max(width^2, height^2) / wavelength, the tunnel begins to guide the waves (Zhang,
"Novel model for propagation loss prediction in tunnels", IEEE Trans. Veh. Technol. 52(5), 2003). Beyond it holds one of
two laws:

* a second slope, with the exponent 1.25 that is measured in straight tunnels (Sensors 22(22):8653, 2022). The default.
* in tunnels with a ``material``, or with ``walls`` in all others, the attenuation of the dominant mode of a rectangular
  tunnel in rock (:mod:`netlab.world.walls`): by refraction into the walls, which falls with the square of the
  frequency, by roughness, and by tilt of the walls, which rises with the frequency.

On a way through several tunnels each has its part: what lies beyond the breakpoint is shared out in proportion to their
lengths, tunnels with walls attenuate their part by their own walls and cross-section, and the second slope goes by the
rest. The order of the tunnels makes no difference, so both directions lose the same.

Corners: a turn of 90 degrees costs ``corner_loss``, slighter turns their part of it. What it costs depends on
frequency, polarisation and cross-section: Jacksha and Zhou, "Measurement of RF propagation around corners in
underground mines and tunnels", Trans. SME 340, 2016, measured 455 to 5800 MHz; set it for your tunnels. Fading is
Rician in line of sight and Rayleigh behind a corner (Boutin et al., IEEE Trans. Antennas Propag. 56(8), 2008).
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from netlab.scenario.base import Switch
from netlab.scenario.walls import WallWords
from netlab.world.geometry import Floats, Geometry
from netlab.world.propagation.model import (
    SPEED_OF_LIGHT_MPS,
    Length,
    Loss,
    PropagationModel,
    Spread,
    free_space_db,
    usable_m,
)


class Tunnel(PropagationModel):
    """See the module's theory. ``breakpoint_m`` None computes it from the narrowest cross-section on the way."""

    needs_terrain: ClassVar[bool] = True
    knows_materials: ClassVar[bool] = True

    corner_loss_db: Loss = Field(default=20.0, alias="corner_loss")
    exponent: Annotated[float, Field(ge=0, le=10)] = 1.25
    breakpoint_m: Length | None = Field(default=None, alias="breakpoint")
    walls: WallWords | None = None
    shadowing_db: Spread = Field(default=3.0, alias="shadowing")
    fading: Switch = True

    def path_loss_db(self, geometry: Geometry, frequency_hz: float) -> Floats:
        """Free space up to the breakpoint, the slope or the walls' attenuation beyond, and the corners."""
        distance_m = usable_m(geometry.distance_m)
        breakpoint_m = self._breakpoint_m(geometry, frequency_hz)
        loss_db = free_space_db(np.minimum(distance_m, breakpoint_m), frequency_hz)
        guided_m = np.maximum(distance_m - breakpoint_m, 0.0)
        bare, decay_db_per_m = self._beyond(geometry, SPEED_OF_LIGHT_MPS / frequency_hz)
        loss_db += 10.0 * self.exponent * np.log10(1.0 + bare * guided_m / breakpoint_m) + decay_db_per_m * guided_m
        loss_db += self.corner_loss_db * geometry.corners
        return loss_db

    def _beyond(self, geometry: Geometry, wavelength_m: float) -> tuple[Floats, Floats]:
        """Of each way, the part in tunnels without walls, and the mean attenuation by the walls of the others."""
        bare = np.ones_like(geometry.distance_m)
        decay_db_per_m = np.zeros_like(geometry.distance_m)
        default = None if self.walls is None else self.walls.walls
        for section, share in zip(geometry.sections, geometry.shares, strict=True):
            if (walls := section.walls or default) is not None:
                decay = walls.attenuation_db_per_m(section.width_m, section.height_m, wavelength_m=wavelength_m)
                decay_db_per_m += share * decay
                bare -= share
        return np.maximum(bare, 0.0), decay_db_per_m

    def _breakpoint_m(self, geometry: Geometry, frequency_hz: float) -> Floats:
        if self.breakpoint_m is not None:
            return np.full_like(geometry.distance_m, self.breakpoint_m)
        widest_m = np.maximum(geometry.width_m, geometry.height_m)
        return usable_m(np.nan_to_num(widest_m**2 * frequency_hz / SPEED_OF_LIGHT_MPS, nan=np.inf))
