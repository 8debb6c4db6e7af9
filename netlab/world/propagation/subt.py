"""The model of DARPA's Subterranean Challenge simulator, for comparing with what teams saw there.

L(d) = 40 dB + 10 (2.5 + 0.2 C) log10(d), where C is the "visibility cost" of the way: the number of tiles, with more
for turns. Links of a cost above 15 or longer than 500 m do not exist. Source: osrf/subt, `subt_rf_interface` (path
loss), `VisibilityRfModel` (cost to exponent, limits), `dot_generator` (cost of tiles: 1 from one straight tile to the
next, 3 into or out of a turn, so that a turn adds 4).

Read on tunnels instead of tiles: a tile for every 20 m of the way, and 4 for a corner of 90 degrees, slighter ones
their part. Its breadcrumbs, which act as ideal relays inside the model, are not taken over: here relays are nodes that
relay. Its `sigma` of 10 dB, drawn anew for every packet and taken for a variance there, is slow fading here.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from netlab.world.geometry import Floats, Geometry
from netlab.world.propagation.model import Length, Loss, PropagationModel, Spread, usable_m

_OUT_OF_RANGE_DB = 1e3
_BEND_COST = 4.0


class Subt(PropagationModel):
    """The defaults are those of the circuit's worlds; see the module's text."""

    reference_loss_db: Loss = Field(default=40.0, alias="reference_loss")
    exponent: Annotated[float, Field(gt=0, le=10)] = 2.5
    cost_exponent: Annotated[float, Field(ge=0, le=10)] = 0.2
    most_cost: Annotated[float, Field(gt=0, le=1000)] = 15.0
    tile_m: Length = Field(default=20.0, alias="tile")
    range_m: Length = Field(default=500.0, alias="range")
    shadowing_db: Spread = Field(default=10.0, alias="shadowing")

    def cost(self, geometry: Geometry) -> Floats:
        """The visibility cost of each way: tiles crossed and turns."""
        tiles: Floats = np.floor(usable_m(geometry.distance_m) / self.tile_m)
        return tiles + _BEND_COST * geometry.corners

    def path_loss_db(self, geometry: Geometry, frequency_hz: float) -> Floats:
        """The formula above, whatever the frequency; 1000 dB beyond the limits."""
        distance_m, cost = usable_m(geometry.distance_m), self.cost(geometry)
        loss_db = self.reference_loss_db + 10.0 * (self.exponent + self.cost_exponent * cost) * np.log10(distance_m)
        reachable = (cost <= self.most_cost) & (distance_m <= self.range_m)
        limited: Floats = np.where(reachable, loss_db, _OUT_OF_RANGE_DB)
        return limited
