"""A tunnel: free space until it acts as a waveguide, then slow decay; a loss at every corner.

Theory. Near the sender a tunnel's walls do not matter and the loss is that of free space. Where the first Fresnel zone
fills the cross-section, at d_bp = max(width^2, height^2) / wavelength, the tunnel begins to guide the waves (Zhang,
"Novel model for propagation loss prediction in tunnels", IEEE Trans. Veh. Technol. 52(5), 2003). Beyond it holds one of
two laws:

* a second slope, with the exponent 1.25 that is measured in straight tunnels (Sensors 22(22):8653, 2022). The default.
* with ``walls``, the attenuation of the dominant mode of a rectangular tunnel in rock: by refraction into the walls,
  which falls with the square of the frequency, by roughness, and by tilt of the walls, which rises with the frequency.
  Source: Emslie, Lagace and Strong, "Theory of the propagation of UHF radio waves in coal mine tunnels", IEEE Trans.
  Antennas Propag. 23(2), 1975, horizontal polarisation.

Corners: a turn of 90 degrees costs ``corner_loss``, slighter turns their part of it. What it costs depends on
frequency, polarisation and cross-section: Jacksha and Zhou, "Measurement of RF propagation around corners in
underground mines and tunnels", Trans. SME 340, 2016, measured 455 to 5800 MHz; set it for your tunnels. Fading is
Rician in line of sight and Rayleigh behind a corner (Boutin et al., IEEE Trans. Antennas Propag. 56(8), 2008).
"""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from netlab.scenario.base import StrictModel, Switch
from netlab.scenario.quantities import ANGLE, LENGTH, Quantity
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

_NEPER_TO_DB = 10.0 / math.log(10.0)  # 4.343


class Walls(StrictModel):
    """The rock around a rectangular tunnel; the defaults are those of a coal mine (Emslie et al., 1975).

    ``permittivity`` is relative, ``roughness_m`` the standard deviation of the surface from its mean plane,
    ``tilt_deg`` that of the planes' angle.
    """

    permittivity: Annotated[float, Field(gt=1, le=100)] = 10.0
    roughness_m: Annotated[float, Quantity(LENGTH, maximum=10.0)] = Field(default=0.1, alias="roughness")
    tilt_deg: Annotated[float, Quantity(ANGLE, maximum=45.0)] = Field(default=1.0, alias="tilt")

    def attenuation_db_per_m(self, width_m: Floats, height_m: Floats, frequency_hz: float) -> Floats:
        """Decay of the horizontally polarised (1, 1) mode by refraction, roughness and tilt."""
        wavelength_m = SPEED_OF_LIGHT_MPS / frequency_hz
        root = math.sqrt(self.permittivity - 1.0)
        refraction = wavelength_m**2 * (self.permittivity / (width_m**3 * root) + 1.0 / (height_m**3 * root))
        roughness = (math.pi * self.roughness_m) ** 2 * wavelength_m * (width_m**-4.0 + height_m**-4.0)
        tilt = (math.pi * math.radians(self.tilt_deg)) ** 2 / wavelength_m
        decay: Floats = _NEPER_TO_DB * (refraction + roughness + tilt)
        return decay


class Tunnel(PropagationModel):
    """See the module's theory. ``breakpoint_m`` None computes it from the narrowest cross-section on the way."""

    needs_terrain: ClassVar[bool] = True

    corner_loss_db: Loss = Field(default=20.0, alias="corner_loss")
    exponent: Annotated[float, Field(ge=0, le=10)] = 1.25
    breakpoint_m: Length | None = Field(default=None, alias="breakpoint")
    walls: Walls | None = None
    shadowing_db: Spread = Field(default=3.0, alias="shadowing")
    fading: Switch = True

    def path_loss_db(self, geometry: Geometry, frequency_hz: float) -> Floats:
        """Free space up to the breakpoint, the slope or the walls' attenuation beyond, and the corners."""
        distance_m = usable_m(geometry.distance_m)
        breakpoint_m = self._breakpoint_m(geometry, frequency_hz)
        loss_db = free_space_db(np.minimum(distance_m, breakpoint_m), frequency_hz)
        if self.walls is None:
            loss_db += 10.0 * self.exponent * np.log10(np.maximum(distance_m / breakpoint_m, 1.0))
        else:
            decay = self.walls.attenuation_db_per_m(geometry.width_m, geometry.height_m, frequency_hz)
            guided_m = np.maximum(distance_m - breakpoint_m, 0.0)
            loss_db += np.where(guided_m > 0.0, decay * guided_m, 0.0)
        loss_db += self.corner_loss_db * geometry.corners
        return loss_db

    def _breakpoint_m(self, geometry: Geometry, frequency_hz: float) -> Floats:
        if self.breakpoint_m is not None:
            return np.full_like(geometry.distance_m, self.breakpoint_m)
        widest_m = np.maximum(geometry.width_m, geometry.height_m)
        return usable_m(np.nan_to_num(widest_m**2 * frequency_hz / SPEED_OF_LIGHT_MPS, nan=np.inf))
