"""Measured values over time: of many links at once, from samples that each link has at times of its own. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from netlab.world.geometry import Floats, Indexes

Sample = tuple[float, float]  # (at_s, value)


class Series:
    """One value per link, held from sample to sample or interpolated between them; after the last one it stays.

    Towards and from an infinite value there is nothing in between: it is held. Times are told apart to the microsecond.
    """

    def __init__(self, samples: Sequence[Sequence[Sample]], *, interpolate: bool) -> None:
        """``samples[link]``, at least one each, in the order of time; of several at one time the last one counts."""
        self._interpolate = interpolate
        counts = [len(own) for own in samples]
        self._first: Indexes = np.cumsum([0, *counts[:-1]], dtype=np.intp)
        self._last: Indexes = self._first + np.array(counts, dtype=np.intp) - 1
        self._times_s: Floats = np.array([at_s for own in samples for at_s, _ in own])
        self._values: Floats = np.array([value for own in samples for _, value in own])
        # All links in one ascending row, each one in the unit interval behind its number: one search finds all.
        self._begin_s, end_s = float(self._times_s.min()), float(self._times_s.max())
        self._span_s = 2.0 * (end_s - self._begin_s) or 1.0
        self._keys = np.repeat(np.arange(len(counts)), counts) + (self._times_s - self._begin_s) / self._span_s

    def at(self, at_s: float) -> Floats:
        """The value of each link; nan before its first sample."""
        place = min(max((at_s - self._begin_s) / self._span_s, -0.1), 0.9)
        here = np.searchsorted(self._keys, np.arange(len(self._first)) + place, side="right") - 1
        known = here >= self._first
        here = np.where(known, here, self._first)
        values: Floats = self._values[here]
        if self._interpolate:
            values = self._between(here, np.minimum(here + 1, self._last), at_s)
        return np.where(known, values, np.nan)

    def _between(self, here: Indexes, following: Indexes, at_s: float) -> Floats:
        begin, end = self._values[here], self._values[following]
        length_s = self._times_s[following] - self._times_s[here]
        joined = (length_s > 0.0) & np.isfinite(begin) & np.isfinite(end)
        share = np.where(joined, (at_s - self._times_s[here]) / np.where(joined, length_s, 1.0), 0.0)
        rise = np.where(joined, end, 0.0) - np.where(joined, begin, 0.0)
        between: Floats = np.where(joined, begin, self._values[here]) + share * rise
        return between


class MeasuredStrengths:
    """How strongly N radios hear each other, where that was measured over time; others stay as they are."""

    def __init__(
        self, constant_dbm: Floats, samples: Mapping[tuple[int, int], Sequence[Sample]], *, interpolate: bool
    ) -> None:
        """
        Args:
            constant_dbm: (N, N), ``[sender, receiver]``; of pairs with samples, what holds before their first one.
            samples: By sender and receiver: times and dBm, -inf where nothing is heard.
            interpolate: See :class:`Series`.
        """
        self._constant_dbm = constant_dbm
        self._senders: Indexes = np.array([sender for sender, _ in samples], dtype=np.intp)
        self._receivers: Indexes = np.array([receiver for _, receiver in samples], dtype=np.intp)
        self._series = Series(list(samples.values()), interpolate=interpolate)

    def rssi_dbm(self, at_s: float) -> Floats:
        """(N, N), ``[sender, receiver]``; -inf for nothing."""
        rssi_dbm = self._constant_dbm.copy()
        values = self._series.at(at_s)
        known = ~np.isnan(values)
        rssi_dbm[self._senders[known], self._receivers[known]] = values[known]
        return rssi_dbm
