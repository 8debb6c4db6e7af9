"""How the latencies of a run are distributed, by priority: what share of the messages had come by when. Values only."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from netlab.traces.model import Trace
from netlab.traces.streams import latencies_s


@dataclass(frozen=True, slots=True)
class Cdf:
    """The latencies of all delivered messages of one priority, in seconds, sorted; ``published`` counts all of them.

    A message that never came weighs as one that takes for ever: the curve ends at ``delivered_ratio``.
    """

    latencies_s: tuple[float, ...]
    published: int

    @property
    def delivered_ratio(self) -> float:
        """Delivered messages over published ones."""
        return len(self.latencies_s) / self.published if self.published else 0.0

    def quantile_s(self, ratio: float) -> float | None:
        """Within what time a share of the *published* messages had come; None if so many never came."""
        index = max(math.ceil(ratio * self.published), 1) - 1
        return self.latencies_s[index] if index < len(self.latencies_s) else None

    def steps(self, *, columns: int) -> list[tuple[float, float]]:
        """Corners (latency, share of the published) of the rising curve, at most two in each of ``columns`` columns.

        Columns are equal on a logarithmic axis; the first and the last corner in each are kept, so that both tails
        stay where they are.
        """
        if not self.latencies_s:
            return []
        corners = [(value, (rank + 1) / self.published) for rank, value in enumerate(self.latencies_s)]
        low, high = (math.log(max(value, 1e-9)) for value in (self.latencies_s[0], self.latencies_s[-1]))
        width = (high - low) / columns or 1.0
        column = [min(int((math.log(max(value, 1e-9)) - low) / width), columns - 1) for value, _ in corners]
        inner = [a != b for a, b in pairwise(column)]
        kept = [first or last for first, last in zip([True, *inner], [*inner, True], strict=True)]
        return [corner for corner, keep in zip(corners, kept, strict=True) if keep]


def latency_cdfs(trace: Trace) -> dict[int, Cdf]:
    """Return the distribution of every priority that published anything, the most urgent first."""
    found: dict[int, tuple[list[float], int]] = {}
    for stream in trace.streams:
        values, published = found.setdefault(stream.priority, ([], 0))
        values += latencies_s(trace, stream.index)
        found[stream.priority] = (values, published + len(trace.published.get(stream.index, [])))
    return {priority: Cdf(tuple(sorted(found[priority][0])), found[priority][1]) for priority in sorted(found)}
