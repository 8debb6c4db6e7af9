"""What the plots of a report show, worked out from a trace. Values only: no file, no drawing.

Times are scenario seconds. A message counts from its first receipt; what a daemon claims of itself counts nowhere.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean, median, pstdev

from netlab.traces.model import Stream, Trace
from netlab.traces.streams import first_deliveries

#: A message of this topic is the team's heartbeat; without one, the topic nearest to this interval is taken.
HEARTBEAT_TOPIC = "management"
HEARTBEAT_S = 1.0
#: Fewer intervals make no histogram.
INTERVALS_MIN = 10
#: From so many nominal intervals on, a time between messages is an interruption and no arrival time.
GAP_INTERVALS = 2.0
#: A node counts as connected while what it published this lately has come through in that time.
CONNECTED_WITHIN_S = 2.0


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Times between receipts of successive messages of one stream while it was connected.

    ``interval_s``: between publications (median). ``intervals_s``: between receipts of messages whose numbers follow
    one another, below ``GAP_INTERVALS`` nominal ones. ``gaps``: all other times between receipts.
    """

    stream: Stream
    interval_s: float
    intervals_s: tuple[float, ...]
    gaps: int

    @property
    def mean_s(self) -> float:
        """Mean of the fitted normal distribution."""
        return fmean(self.intervals_s)

    @property
    def sigma_s(self) -> float:
        """Standard deviation of the fitted normal distribution."""
        return pstdev(self.intervals_s)

    @property
    def ratio_within(self) -> float:
        """Share of the intervals within 5 % of the nominal one."""
        return fmean(abs(value - self.interval_s) <= 0.05 * self.interval_s for value in self.intervals_s)


def heartbeat_topic(trace: Trace) -> str | None:
    """Return the topic whose arrivals say most of the connection; None if nothing was published twice."""
    known: dict[str, float] = {}
    for stream in trace.streams:
        nominal = interval_s(trace, stream)
        if nominal is not None:
            known.setdefault(stream.topic, nominal)
    if HEARTBEAT_TOPIC in known:
        return HEARTBEAT_TOPIC
    return min(known, key=lambda topic: abs(math.log(known[topic] / HEARTBEAT_S)), default=None)


def interval_s(trace: Trace, stream: Stream) -> float | None:
    """Median time between publications of a stream, in seconds; None with fewer than two."""
    times = [entry.t_ns for entry in trace.published.get(stream.index, [])]
    steps = [later - earlier for earlier, later in pairwise(times) if later > earlier]
    return median(steps) / 1e9 if steps else None


def arrivals(trace: Trace, topic: str) -> list[Arrivals]:
    """Return the arrivals of every stream of a topic that has enough of them, in scenario order."""
    found = []
    for stream in trace.streams:
        nominal = interval_s(trace, stream) if stream.topic == topic else None
        if nominal is None:
            continue
        received = sorted(first_deliveries(trace, stream.index), key=lambda delivery: delivery.seq)
        pairs = list(pairwise(received))
        steps = [(b.t_ns - a.t_ns) / 1e9 for a, b in pairs if b.seq == a.seq + 1]
        values = tuple(step for step in steps if step < GAP_INTERVALS * nominal)
        if len(values) >= INTERVALS_MIN:
            found.append(Arrivals(stream, nominal, values, len(pairs) - len(values)))
    return found


def volumes(trace: Trace) -> dict[str, dict[str, int]]:
    """Return delivered payload in bytes, each message once per destination, by topic and publishing node."""
    found: dict[str, dict[str, int]] = {}
    for stream in trace.streams:
        size = sum(delivery.size_bytes for delivery in first_deliveries(trace, stream.index))
        if size:
            by_source = found.setdefault(stream.topic, {})
            by_source[stream.source] = by_source.get(stream.source, 0) + size
    return found


@dataclass(frozen=True, slots=True)
class Points:
    """One series: when, and how much."""

    at_s: tuple[float, ...]
    values: tuple[float, ...]


def latencies(trace: Trace) -> dict[int, Points]:
    """Return every message's latency in seconds over the time of its publication, by priority, most urgent first."""
    found: dict[int, list[tuple[float, float]]] = {}
    for stream in trace.streams:
        found.setdefault(stream.priority, []).extend(
            (trace.seconds(delivery.published_ns), delivery.latency_s)
            for delivery in first_deliveries(trace, stream.index)
        )
    return {priority: points(found[priority]) for priority in sorted(found) if found[priority]}


def waiting(trace: Trace) -> dict[str, Points]:
    """Return payload that was published and not yet delivered, in bytes over time, by publishing node.

    Of messages that came through in the end; each counts once per destination, from its publication to its receipt.
    """
    steps: dict[str, list[tuple[float, int]]] = {}
    for stream in trace.streams:
        own = steps.setdefault(stream.source, [])
        for delivery in first_deliveries(trace, stream.index):
            own.append((trace.seconds(delivery.published_ns), delivery.size_bytes))
            own.append((trace.seconds(delivery.t_ns), -delivery.size_bytes))
    return {node: _running_sum(own) for node, own in steps.items() if own}


def _running_sum(steps: list[tuple[float, int]]) -> Points:
    total, found = 0, []
    for at_s, change in sorted(steps):
        total += change
        found.append((at_s, float(total)))
    return points(found)


def points(pairs: Iterable[tuple[float, float]]) -> Points:
    """Return a series in the order of time."""
    ordered = sorted(pairs)
    return Points(tuple(at_s for at_s, _ in ordered), tuple(value for _, value in ordered))


def envelope(series: Points, *, columns: int) -> Points:
    """Thin a series out to the least and the most in each of ``columns`` parts of its time: no peak is lost."""
    if len(series.at_s) <= 2 * columns:
        return series
    first_s, span_s = series.at_s[0], (series.at_s[-1] - series.at_s[0]) or 1.0
    kept: list[tuple[float, float]] = []
    for column in range(columns):
        start = bisect_left(series.at_s, first_s + span_s * column / columns)
        is_last = column == columns - 1
        end = len(series.at_s) if is_last else bisect_left(series.at_s, first_s + span_s * (column + 1) / columns)
        if start < end:
            part = range(start, end)
            ends = {min(part, key=series.values.__getitem__), max(part, key=series.values.__getitem__)}
            kept += [(series.at_s[i], series.values[i]) for i in sorted(ends)]
    return Points(tuple(at_s for at_s, _ in kept), tuple(value for _, value in kept))


def thinned_path(places: Sequence[tuple[float, float]], *, most: int = 400) -> list[tuple[float, float]]:
    """Thin a way out to ``most`` places at most, its corners first: what lies straight between two others can go.

    A place stays that is farther from the line between its neighbours than a tolerance, which grows until few are left
    (Ramer 1972, Douglas and Peucker 1973).
    """
    extent = max((max(axis) - min(axis) for axis in zip(*places, strict=True)), default=0.0)
    tolerance = extent / 4000
    kept = _simplified(list(places), tolerance)
    while len(kept) > most:
        tolerance *= 2
        kept = _simplified(kept, tolerance)
    return kept


def _simplified(places: list[tuple[float, float]], tolerance: float) -> list[tuple[float, float]]:
    keep, todo = {0, len(places) - 1}, [(0, len(places) - 1)]
    while todo:
        first, last = todo.pop()
        far, at = max(
            ((_distance(places[i], places[first], places[last]), i) for i in range(first + 1, last)), default=(0.0, 0)
        )
        if far > tolerance:
            keep.add(at)
            todo += [(first, at), (at, last)]
    return [places[i] for i in sorted(keep)]


def _distance(place: tuple[float, float], start: tuple[float, float], end: tuple[float, float]) -> float:
    """From a place to the straight piece between two others."""
    along = (end[0] - start[0], end[1] - start[1])
    length2 = along[0] ** 2 + along[1] ** 2
    part = ((place[0] - start[0]) * along[0] + (place[1] - start[1]) * along[1]) / length2 if length2 else 0.0
    part = min(max(part, 0.0), 1.0)
    return math.dist(place, (start[0] + part * along[0], start[1] + part * along[1]))


class Contact:
    """When messages went between a node and the base, in either direction."""

    def __init__(self, trace: Trace, node: str, base: str) -> None:
        ends = {node, base}
        streams = [stream for stream in trace.streams if {stream.source, stream.destination} == ends]
        slowest_s = max((interval_s(trace, stream) or 0.0 for stream in streams), default=0.0)
        self._within_s = max(CONNECTED_WITHIN_S, 2 * slowest_s)
        self.is_known = bool(streams)
        self._heard_s = sorted(
            trace.seconds(delivery.published_ns)
            for stream in streams
            for delivery in first_deliveries(trace, stream.index)
            if delivery.latency_s <= self._within_s
        )

    def at(self, at_s: float) -> bool:
        """Whether something that was published lately came through without waiting longer than that.

        At the very beginning nothing was published before: what follows soon counts.
        """
        until_s = max(at_s, self._within_s)
        return bisect_right(self._heard_s, until_s) > bisect_left(self._heard_s, at_s - self._within_s)


@dataclass(frozen=True, slots=True)
class Grid:
    """A quantity over time for several rows: ``values[row][column]``, None where nothing is known.

    Column ``i`` is [start_s + i column_s, start_s + (i + 1) column_s).
    """

    rows: tuple[str, ...]
    start_s: float
    column_s: float
    values: tuple[tuple[float | None, ...], ...]


def grid(samples: Mapping[str, Sequence[tuple[float, float]]], *, start_s: float, end_s: float, columns: int) -> Grid:
    """Average samples (time, value) by row and column; rows keep their order, times outside are left out."""
    column_s = max(end_s - start_s, 1e-9) / columns
    rows = []
    for found in samples.values():
        cells: list[list[float]] = [[] for _ in range(columns)]
        for at_s, value in found:
            if start_s <= at_s < end_s:
                cells[min(int((at_s - start_s) / column_s), columns - 1)].append(value)
        rows.append(tuple(fmean(cell) if cell else None for cell in cells))
    return Grid(tuple(samples), start_s, column_s, tuple(rows))
