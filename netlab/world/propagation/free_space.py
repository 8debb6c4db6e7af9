"""Free space: nothing but distance. With terrain the distance is the way along the tunnels."""

from __future__ import annotations

from netlab.world.geometry import Floats, Geometry
from netlab.world.propagation.model import PropagationModel, free_space_db, usable_m


class FreeSpace(PropagationModel):
    """Friis' formula (see :func:`~netlab.world.propagation.model.free_space_db`); no fading unless asked for."""

    def path_loss_db(self, geometry: Geometry, frequency_hz: float) -> Floats:
        """20 log10(4 pi d f / c)."""
        return free_space_db(usable_m(geometry.distance_m), frequency_hz)
