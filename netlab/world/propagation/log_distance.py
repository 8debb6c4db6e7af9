"""Log-distance: the mean loss grows with a power of the distance that was measured somewhere."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from netlab.world.geometry import Floats, Geometry
from netlab.world.propagation.model import Length, Loss, PropagationModel, free_space_db, usable_m


class LogDistance(PropagationModel):
    """L(d) = L(d0) + 10 n log10(d / d0), and a loss per corner where there are tunnels.

    ``reference_loss_db`` at ``reference_distance_m`` defaults to free space. Source: Rappaport, "Wireless
    Communications", 2nd edition, section 4.9.1; with ``shadowing`` its log-normal shadowing, 4.9.2.
    """

    exponent: Annotated[float, Field(gt=0, le=10)] = 3.0
    reference_distance_m: Length = Field(default=1.0, alias="reference_distance")
    reference_loss_db: Loss | None = Field(default=None, alias="reference_loss")
    corner_loss_db: Loss = Field(default=0.0, alias="corner_loss")

    def path_loss_db(self, geometry: Geometry, frequency_hz: float) -> Floats:
        """The formula above; nearer than the reference distance the loss stays what it is there."""
        distance_m = np.maximum(usable_m(geometry.distance_m), self.reference_distance_m)
        reference_db = self.reference_loss_db
        if reference_db is None:
            reference_db = float(free_space_db(np.array(self.reference_distance_m), frequency_hz))
        decades = np.log10(distance_m / self.reference_distance_m)
        loss_db: Floats = reference_db + 10.0 * self.exponent * decades + self.corner_loss_db * geometry.corners
        return loss_db
