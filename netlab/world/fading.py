"""How signals waver around their mean: slowly by shadowing, fast by waves that add up. Pure and reproducible.

The gain of a pair is a function of the seed, the two radios' names, their positions and the time, and of nothing else:
not of the traffic, the engine, other radios or the order of calls. It is the same both ways, and two radios that come
back to where they were find the same fade there.

Shadowing is a Gaussian field in decibels over the positions of both ends, with the autocorrelation exp(-d / D) over a
distance d that one end moves (Gudmundson, "Correlation model for shadow fading in mobile radio systems", Electronics
Letters 27(23), 1991). It is a sum of cosines whose wave vectors follow that autocorrelation's spectrum in the plane.

Fast fading is that of Clarke and Jakes with both ends free to move (Akki and Haber, "A statistical model of
mobile-to-mobile land communication channel", IEEE Trans. Veh. Technol. 35(1), 1986): waves that leave and arrive in
random horizontal directions. Behind a corner they are all there is (Rayleigh); in line of sight a direct wave carries
K / (K + 1) of the power (Rice). The amplitude's autocorrelation over a distance d of one end is J0(2 pi d / lambda),
zero at 0.38 wavelengths. The waves' phases drift, so that radios at rest see slow changes. The mean power is exactly 1:
fading moves power around, and neither adds nor takes any.

Height is left out: a robot that climbs straight up keeps its fade.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from netlab.world.geometry import Flags, Floats, Indexes

_TURN = 2.0 * math.pi
_WAVES = 16
_COSINES = 16
_LEAST_GAIN = 1e-6  # a fade of 60 dB; deeper ones are rarer than one in a million


@dataclass(frozen=True, slots=True)
class FadingSettings:
    """``rice_k_db`` None means no fast fading; ``shadowing_db`` (standard deviation) 0 no slow one.

    ``shadowing_distance_m`` is where shadowing's autocorrelation has fallen to 1/e, ``drift_hz`` the highest frequency
    that the surroundings' changes add to the waves.
    """

    shadowing_db: float = 0.0
    shadowing_distance_m: float = 10.0
    rice_k_db: float | None = None
    drift_hz: float = 0.05


class Fading:
    """The gains of all pairs of N radios, in one go."""

    def __init__(self, names: Sequence[str], wavelengths_m: Floats, settings: FadingSettings, *, seed: int) -> None:
        """
        Args:
            names: The radios', distinct; a pair's fading depends on its two names alone.
            wavelengths_m: (N,); a pair of different wavelengths never meets, its gain means nothing.
            settings: The same for all pairs.
            seed: The lab's.
        """
        self._settings = settings
        order = sorted(range(len(names)), key=names.__getitem__)
        upper = [np.asarray(order, dtype=np.intp)[index] for index in np.triu_indices(len(names), k=1)]
        self._first: Indexes = upper[0]  # of each pair, the radio whose name sorts first
        self._second: Indexes = upper[1]
        self._size = len(names)
        self._waves_per_m: Floats = 1.0 / wavelengths_m[self._first][:, None]
        draws = _draws(names, self._first, self._second, seed)
        self._shadows = _Shadows(draws[:, : 5 * _COSINES], settings)
        self._waves = _Waves(draws[:, 5 * _COSINES :], settings)

    def gain_db(self, positions_m: Floats, distance_m: Floats, line_of_sight: Flags, at_s: float) -> Floats:
        """What fading adds to the mean power, (N, N), symmetric, 0 on the diagonal.

        Args:
            positions_m: (N, 3) of the radios.
            distance_m: (N, N) along the way; only its changes count.
            line_of_sight: (N, N).
            at_s: Scenario time.
        """
        first, second, settings = self._first, self._second, self._settings
        ends = tuple(positions_m[index, axis][:, None] for index in (first, second) for axis in (0, 1))
        gain_db: Floats = np.zeros(len(first))
        if settings.shadowing_db:
            gain_db += self._shadows.gain_db(ends)
        if settings.rice_k_db is not None:
            direct = np.where(np.isfinite(distance_m[first, second]), distance_m[first, second], 0.0)
            gain_db += self._waves.gain_db(ends, self._waves_per_m, direct, line_of_sight[first, second], at_s)
        matrix = np.zeros((self._size, self._size))
        matrix[first, second] = gain_db
        matrix[second, first] = gain_db
        return matrix


_Ends = tuple[Floats, ...]  # x and y of the first radio, x and y of the second; each (pairs, 1)


class _Shadows:
    """A Gaussian field per pair: sigma sqrt(2 / M) sum cos(k1 p1 + k2 p2 + phase). All phases are in turns."""

    def __init__(self, draws: Floats, settings: FadingSettings) -> None:
        radius1, angle1, radius2, angle2, self._phase = np.split(draws, 5, axis=1)
        self._vectors = _plane_waves(radius1, angle1, settings) + _plane_waves(radius2, angle2, settings)
        self._scale = settings.shadowing_db * math.sqrt(2.0 / _COSINES)

    def gain_db(self, ends: _Ends) -> Floats:
        angles = _angles(ends, self._vectors, self._phase)
        gain: Floats = self._scale * np.cos(angles).sum(axis=1, dtype=np.float64)
        return gain


def _plane_waves(radius: Floats, angle: Floats, settings: FadingSettings) -> _Ends:
    """Wave vectors, the spectrum of exp(-d / D) in two dimensions: P(|k| > q) = 1 / sqrt(1 + q^2 D^2)."""
    wavenumber = np.sqrt(1.0 / (1.0 - radius) ** 2 - 1.0) / settings.shadowing_distance_m
    turns_per_m = wavenumber / _TURN
    return turns_per_m * np.cos(_TURN * angle), turns_per_m * np.sin(_TURN * angle)


class _Waves:
    """Waves between two ends that scatter around both."""

    def __init__(self, draws: Floats, settings: FadingSettings) -> None:
        leaving, arriving, self._phase, drift = np.split(draws, 4, axis=1)
        self._directions: _Ends = tuple(f(_TURN * angle) for angle in (leaving, arriving) for f in (np.cos, np.sin))
        self._drift: Floats = settings.drift_hz * (2.0 * drift - 1.0)
        factor = 10.0 ** (settings.rice_k_db / 10.0) if settings.rice_k_db is not None else 0.0
        self._direct_in_sight = math.sqrt(factor / (factor + 1.0))
        self._scattered_in_sight = math.sqrt(1.0 / (factor + 1.0))

    def gain_db(self, ends: _Ends, waves_per_m: Floats, distance_m: Floats, in_sight: Flags, at_s: float) -> Floats:
        scaled = tuple(waves_per_m * end for end in ends)
        angles = _angles(scaled, self._directions, self._phase + self._drift * at_s)
        real = np.cos(angles).sum(axis=1, dtype=np.float64) / math.sqrt(_WAVES)
        imaginary = np.sin(angles).sum(axis=1, dtype=np.float64) / math.sqrt(_WAVES)
        scattered = np.where(in_sight, self._scattered_in_sight, 1.0)
        direct = np.where(in_sight, self._direct_in_sight, 0.0)
        turn = _TURN * waves_per_m[:, 0] * distance_m
        power = (scattered * real + direct * np.cos(turn)) ** 2 + (scattered * imaginary + direct * np.sin(turn)) ** 2
        gain: Floats = 10.0 * np.log10(np.maximum(power, _LEAST_GAIN))
        return gain


def _angles(ends: _Ends, turns_per_m: _Ends, start: Floats) -> NDArray[np.float32]:
    """Radians within one turn; single precision from there on, for which cosines cost a tenth."""
    turns = start.copy()
    for end, component in zip(ends, turns_per_m, strict=True):
        turns += end * component
    turns -= np.rint(turns)
    return turns.astype(np.float32) * np.float32(_TURN)


def _draws(names: Sequence[str], first: Indexes, second: Indexes, seed: int) -> Floats:
    """Uniform numbers, one row per pair, from the seed and the names alone."""
    count = 5 * _COSINES + 4 * _WAVES
    rows = [_generator(seed, names[a], names[b]).random(count) for a, b in zip(first, second, strict=True)]
    return np.array(rows).reshape(len(rows), count)


def _generator(seed: int, a: str, b: str) -> np.random.Generator:
    digest = hashlib.blake2b(repr(("fading", seed, a, b)).encode(), digest_size=16).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest, "little")))
