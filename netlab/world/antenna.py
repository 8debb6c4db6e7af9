"""Antennas: gain by direction in the horizontal plane, relative to the robot that carries them. Pure.

A pattern is a table of 360 gains, one per degree, with linear interpolation between; angles count counter-clockwise,
0 is straight ahead. A direction's elevation is left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from netlab.world.geometry import Floats

_DEGREES = 360


@dataclass(frozen=True, slots=True)
class Antenna:
    """``gains_dbi[k]`` is the gain k degrees counter-clockwise of straight ahead; 360 of them."""

    gains_dbi: tuple[float, ...]

    def __post_init__(self) -> None:
        """
        Raises:
            ValueError: Not 360 finite gains.
        """
        if len(self.gains_dbi) != _DEGREES or not all(map(math.isfinite, self.gains_dbi)):
            raise ValueError(f"an antenna has {_DEGREES} finite gains, one per degree")


def omni(gain_dbi: float = 0.0) -> Antenna:
    """The same gain all around."""
    return Antenna((gain_dbi,) * _DEGREES)


def sector(
    gain_dbi: float, *, beamwidth_deg: float, front_to_back_db: float = 20.0, facing_deg: Sequence[float] = (0.0,)
) -> Antenna:
    """A sector antenna, or several on one radio: the strongest in each direction counts.

    Its loss off axis is 12 (angle / beamwidth)^2 dB, at most ``front_to_back_db``. Source: 3GPP TR 36.814, table
    A.2.1.1-2 (there 70 degrees and 25 dB).

    Args:
        gain_dbi: On axis.
        beamwidth_deg: Between the directions that are 3 dB weaker; above 0.
        front_to_back_db: Between the front and the weakest direction; at least 0.
        facing_deg: Where each points, counter-clockwise from straight ahead; 0 and 180 are fore and aft.

    Raises:
        ValueError: No direction, or a value outside its bounds.
    """
    if not facing_deg or beamwidth_deg <= 0 or front_to_back_db < 0:
        raise ValueError("a sector needs a direction, a beamwidth above 0 and a front-to-back ratio of 0 or more")
    degrees = np.arange(_DEGREES, dtype=np.float64)
    off_axis_deg = np.min([np.abs(_wrapped(degrees - facing)) for facing in facing_deg], axis=0)
    loss_db = np.minimum(12.0 * (off_axis_deg / beamwidth_deg) ** 2, front_to_back_db)
    return Antenna(tuple((gain_dbi - loss_db).tolist()))


def table(points: Sequence[tuple[float, float]]) -> Antenna:
    """A measured pattern: (degrees, dBi) in any order, linear between them, around the circle.

    Raises:
        ValueError: No points, or two at the same angle.
    """
    if not points:
        raise ValueError("a pattern needs at least one point")
    angles = [math.fmod(degrees, _DEGREES) % _DEGREES for degrees, _ in points]
    if len(set(angles)) != len(angles):
        raise ValueError("two points of the pattern are at the same angle")
    gains = np.interp(np.arange(_DEGREES), angles, [gain for _, gain in points], period=_DEGREES)
    return Antenna(tuple(gains.tolist()))


class Antennas:
    """The antennas of N radios, for gains of all pairs at once."""

    def __init__(self, antennas: Sequence[Antenna]) -> None:
        self._is_omni = all(len(set(antenna.gains_dbi)) == 1 for antenna in antennas)
        wrapped = [(*antenna.gains_dbi, antenna.gains_dbi[0]) for antenna in antennas]
        self._gains: Floats = np.array(wrapped, dtype=np.float64).reshape(len(wrapped), _DEGREES + 1)

    def gain_dbi(self, headings_deg: Floats, bearing_deg: Floats) -> Floats:
        """Both ends' gains together, (N, N), symmetric.

        Args:
            headings_deg: (N,) of the robots.
            bearing_deg: (N, N): in which direction i's radiation leaves for j.
        """
        if self._is_omni:
            towards = np.broadcast_to(self._gains[:, :1], bearing_deg.shape)
        else:
            angles = (bearing_deg - headings_deg[:, None]) % _DEGREES
            below = np.minimum(angles.astype(np.intp), _DEGREES - 1)
            rows = np.arange(len(self._gains))[:, None]
            low, high = self._gains[rows, below], self._gains[rows, below + 1]
            towards = low + (high - low) * (angles - below)
        both: Floats = towards + towards.T
        return both


def _wrapped(degrees: Floats) -> Floats:
    """The same angles within -180 to 180."""
    within: Floats = (degrees + 180.0) % _DEGREES - 180.0
    return within
