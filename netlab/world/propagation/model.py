"""What every propagation model is: its words in a scenario, the path loss, and how signals fade around it.

A model is a scenario block: its fields are the words that may stand in `propagation:` beside `model:`, checked and
converted to SI units before anything starts. It is pure: geometry and frequency in, decibels out.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from netlab.scenario.base import StrictModel, Switch
from netlab.scenario.quantities import DECIBELS, FREQUENCY, LENGTH, Quantity
from netlab.world.fading import FadingSettings
from netlab.world.geometry import Floats, Geometry

SPEED_OF_LIGHT_MPS = 299_792_458.0
#: Nearer than this no model holds: the loss is that of one metre.
NEAREST_M = 1.0
_FARTHEST_M = 1e7

Loss = Annotated[float, Quantity(DECIBELS, maximum=200.0)]
Spread = Annotated[float, Quantity(DECIBELS, maximum=20.0)]
RiceFactor = Annotated[float, Quantity(DECIBELS, minimum=-20.0, maximum=30.0)]
Drift = Annotated[float, Quantity(FREQUENCY, maximum=100.0)]
Length = Annotated[float, Quantity(LENGTH, above_minimum=True, maximum=1e6)]


class PropagationModel(StrictModel):
    """Base of all models. The words here belong to each of them; a model may give them other defaults.

    ``shadowing_db`` is the standard deviation of slow fading, which decorrelates over ``shadowing_distance_m``;
    ``fading`` switches fast fading, with ``rice_k_db`` as its K factor in line of sight; ``drift_hz`` is how fast the
    surroundings change it around radios that stand still.
    """

    #: True where the model is about tunnels and means nothing without them.
    needs_terrain: ClassVar[bool] = False
    #: True where it reads what the tunnels are made of (``Geometry.sections``).
    knows_materials: ClassVar[bool] = False

    shadowing_db: Spread = Field(default=0.0, alias="shadowing")
    shadowing_distance_m: Length = Field(default=10.0, alias="shadowing_distance")
    fading: Switch = False
    rice_k_db: RiceFactor = Field(default=6.0, alias="rice_k")
    drift_hz: Drift = Field(default=0.05, alias="drift")

    @abstractmethod
    def path_loss_db(self, geometry: Geometry, frequency_hz: float) -> Floats:
        """The mean loss between isotropic antennas, index [from, to]; where no way leads, anything but nan."""

    @property
    def fading_settings(self) -> FadingSettings:
        """Fast and slow fading as values."""
        return FadingSettings(
            shadowing_db=self.shadowing_db,
            shadowing_distance_m=self.shadowing_distance_m,
            rice_k_db=self.rice_k_db if self.fading else None,
            drift_hz=self.drift_hz,
        )


def usable_m(distance_m: Floats) -> Floats:
    """Distances that a logarithm can take: at least ``NEAREST_M``, and finite where no way leads."""
    usable: Floats = np.clip(distance_m, NEAREST_M, _FARTHEST_M)
    return usable


def free_space_db(distance_m: Floats, frequency_hz: float) -> Floats:
    """Free-space loss between isotropic antennas at ``distance_m`` (> 0): 20 log10(4 pi d f / c).

    Source: Friis, "A note on a simple transmission formula", Proc. IRE 34(5), 1946; ITU-R P.525-4.
    """
    loss_db: Floats = 20.0 * np.log10(distance_m) + 20.0 * math.log10(4.0 * math.pi * frequency_hz / SPEED_OF_LIGHT_MPS)
    return loss_db
