"""The link budget: how strongly every radio hears every other, at one moment. Pure.

rssi = transmit power + both antennas' gains - path loss + fading. Radios on different frequencies, radios of nodes that
are still carried, and pairs that no way joins hear nothing (-inf). Everything is the same both ways but the power.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from netlab.world.antenna import Antenna, Antennas, omni
from netlab.world.fading import Fading
from netlab.world.geometry import Floats, Geometry, Indexes, Moment
from netlab.world.propagation.model import SPEED_OF_LIGHT_MPS, PropagationModel


@dataclass(frozen=True, slots=True)
class RadioUnit:
    """One radio of a robot. ``name`` is distinct and stable (node and interface): fading depends on it."""

    name: str
    node: int  # its place among the moment's nodes
    frequency_hz: float = 2.437e9
    tx_power_dbm: float = 20.0
    antenna: Antenna = field(default_factory=omni)


class LinkBudget:
    """All radios of a lab under one propagation model."""

    def __init__(self, radios: Sequence[RadioUnit], model: PropagationModel, *, seed: int) -> None:
        self._model = model
        self.node_of_radio: Indexes = np.array([radio.node for radio in radios], dtype=np.intp)
        self._power_dbm: Floats = np.array([radio.tx_power_dbm for radio in radios], dtype=np.float64)
        self._frequency_hz: Floats = np.array([radio.frequency_hz for radio in radios], dtype=np.float64)
        self._antennas = Antennas([radio.antenna for radio in radios])
        names = [radio.name for radio in radios]
        self._fading = Fading(names, SPEED_OF_LIGHT_MPS / self._frequency_hz, model.fading_settings, seed=seed)
        self._deaf = self._frequency_hz[:, None] != self._frequency_hz[None, :]
        np.fill_diagonal(self._deaf, True)

    def rssi_dbm(self, moment: Moment, geometry: Geometry, at_s: float) -> Floats:
        """(N, N), index [sender, receiver]; -inf where nothing is heard, and on the diagonal.

        Args:
            moment: The nodes.
            geometry: The radios', in their order: ``world.geometry(moment, budget.node_of_radio)``.
            at_s: Scenario time.
        """
        nodes = self.node_of_radio
        gain_db = self._antennas.gain_dbi(moment.headings_deg[nodes], geometry.bearing_deg)
        gain_db += self._fading.gain_db(moment.positions_m[nodes], geometry.distance_m, geometry.line_of_sight, at_s)
        rssi_dbm = self._power_dbm[:, None] + gain_db - self._path_loss_db(geometry)
        active = moment.active[nodes]
        silent = self._deaf | np.isinf(geometry.distance_m) | ~(active[:, None] & active[None, :])
        rssi_dbm[silent] = -np.inf
        return rssi_dbm

    def _path_loss_db(self, geometry: Geometry) -> Floats:
        frequencies = np.unique(self._frequency_hz)
        loss_db = self._model.path_loss_db(geometry, float(frequencies[0]))
        for frequency_hz in frequencies[1:]:
            on_it = (self._frequency_hz == frequency_hz)[:, None]
            loss_db = np.where(on_it, self._model.path_loss_db(geometry, float(frequency_hz)), loss_db)
        return loss_db
