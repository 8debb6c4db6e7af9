"""What is marked on every plot over time: acts on the lab, times without a link, the worst instances. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from netlab.report.expected import Evidence
from netlab.report.words import listed
from netlab.traces.model import Trace

_ACTS_MAX = 40

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Marks:
    """Times in scenario seconds. ``worst``: (numbers of the evidence, when published, latency in seconds)."""

    acts_s: tuple[float, ...] = ()
    down_s: tuple[Span, ...] = ()
    worst: tuple[tuple[str, float, float], ...] = ()


def marks(
    trace: Trace, down_s: Mapping[tuple[str, str], Sequence[Span]], found: Sequence[Evidence], *, is_meshed: bool
) -> Marks:
    """Return the marks of a run.

    Args:
        trace: The run.
        down_s: When links were down, by directed pair of nodes, as in the scene.
        found: Its expectations.
        is_meshed: Frames find other ways than a link of their own, so that its state says little.
    """
    return Marks(acts_s(trace), () if is_meshed else streams_down_s(trace, down_s), _worst(found))


def acts_s(trace: Trace) -> tuple[float, ...]:
    """When something was done to the lab; none where it was done so often that lines would hide the rest."""
    times = sorted({round(step.at_s, 2) for step in trace.timeline if step.kind not in ("start", "end", "radio")})
    return tuple(times) if len(times) <= _ACTS_MAX else ()


def streams_down_s(trace: Trace, down_s: Mapping[tuple[str, str], Sequence[Span]]) -> tuple[Span, ...]:
    """When a stream's two nodes had no link of their own although they have one at other times; merged, in order."""
    pairs = {(stream.source, stream.destination) for stream in trace.streams}
    spans = sorted(span for pair in pairs for span in down_s.get(pair, ()) if span[0] < trace.duration_s)
    merged: list[Span] = []
    for start_s, end_s in spans:
        start_s, end_s = max(start_s, 0.0), min(end_s, trace.duration_s)
        if merged and start_s <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], end_s))
        elif end_s > start_s:
            merged.append((start_s, end_s))
    return tuple(merged) if len(merged) <= _ACTS_MAX else ()


def _worst(found: Sequence[Evidence]) -> tuple[tuple[str, float, float], ...]:
    """One mark per message, with the numbers of all expectations that it is the worst instance of."""
    numbers: dict[tuple[float, float], list[int]] = {}
    for entry in found:
        worst = entry.worst
        if worst is not None and worst.at_s is not None and worst.latency_s is not None:
            numbers.setdefault((worst.at_s, worst.latency_s), []).append(entry.number)
    return tuple((listed(group), *at) for at, group in numbers.items())
