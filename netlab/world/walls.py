"""What tunnels are made of, and how that weakens waves which a tunnel guides. Pure, without NumPy.

Source of the attenuation: Emslie, Lagace and Strong, "Theory of the propagation of UHF radio waves in coal mine
tunnels", IEEE Trans. Antennas Propag. 23(2), 1975: the dominant mode, horizontally polarised.

Sources of the materials' permittivity: coal, Emslie et al.; concrete and brick, ITU-R P.2040-3, table 3; limestone (as
calcite, Keller), sandstone (as quartz), salt (as halite) and ice, Olhoeft, both in Martinez and Byrnes, "Modeling
dielectric-constant values of geologic materials", Kansas Geological Survey Bulletin 247, 2001, table 2; granite, Davis
and Annan, "Ground-penetrating radar for high-resolution mapping of soil and rock stratigraphy", Geophysical Prospecting
37, 1989: 4 to 6. Roughness and tilt are the digger's and not the rock's. For hewn rock they are those of Emslie's coal
mine, an assumption. Lined tunnels have none: the attenuation that Zhou et al., "Attenuation constants of radio waves in
lossy-walled rectangular waveguides", PIER 142, 2013, measured in a straight one of concrete is that of refraction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

_NEPER_TO_DB = 10.0 / math.log(10.0)  # 4.343
_COAL_MINE_ROUGHNESS_M = 0.1
_COAL_MINE_TILT_DEG = 1.0


@dataclass(frozen=True, slots=True)
class Walls:
    """The walls of a rectangular tunnel; the defaults are those of a coal mine.

    ``permittivity`` is relative (above 1), ``roughness_m`` the standard deviation of the surface from its mean plane,
    ``tilt_deg`` that of the planes' angle.
    """

    permittivity: float = 10.0
    roughness_m: float = _COAL_MINE_ROUGHNESS_M
    tilt_deg: float = _COAL_MINE_TILT_DEG

    def attenuation_db_per_m(self, width_m: float, height_m: float, *, wavelength_m: float) -> float:
        """Decay of the horizontally polarised (1, 1) mode by refraction, roughness and tilt; see the module."""
        root = math.sqrt(self.permittivity - 1.0)
        refraction = wavelength_m**2 * (self.permittivity / (width_m**3 * root) + 1.0 / (height_m**3 * root))
        roughness = (math.pi * self.roughness_m) ** 2 * wavelength_m * (1.0 / width_m**4 + 1.0 / height_m**4)
        tilt = (math.pi * math.radians(self.tilt_deg)) ** 2 / wavelength_m
        return _NEPER_TO_DB * (refraction + roughness + tilt)


@dataclass(frozen=True, slots=True)
class Section:
    """A kind of tunnel: its cross-section, and its walls where they are known."""

    width_m: float
    height_m: float
    walls: Walls | None = None


def _lined(permittivity: float) -> Walls:
    return Walls(permittivity, roughness_m=0.0, tilt_deg=0.0)


#: Walls by name; see the module's sources.
MATERIALS: Mapping[str, Walls] = {
    "coal": Walls(10.0),
    "limestone": Walls(8.0),
    "granite": Walls(5.0),
    "sandstone": Walls(4.5),
    "salt": Walls(5.9),
    "ice": Walls(3.4),
    "concrete": _lined(5.24),
    "brick": _lined(3.91),
}
