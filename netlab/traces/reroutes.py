"""How long after each cut that left another path the first message came through that was published after it."""

from __future__ import annotations

from dataclasses import dataclass

from netlab.traces.model import NS_PER_S, Step, Trace
from netlab.traces.streams import first_deliveries


@dataclass(frozen=True, slots=True)
class Reroute:
    """One cut, for two nodes of a mesh. ``delay_s`` is None if nothing fresh came through until the end.

    A cut of a link that carried nothing between them shows as a delay of about one message interval.
    """

    between: tuple[str, str]
    cut_at_s: float
    delay_s: float | None
    cut_ns: int


def reroutes(trace: Trace) -> list[Reroute]:
    """One entry per cut and pair of nodes that still had a path, in the order of time.

    The delay is that of the slowest stream between the two, in either direction: each direction finds its own way.
    What was published before the cut does not count, wherever it was; so frames that were past the cut do not either.
    """
    return [_reroute(trace, step, between) for step in trace.timeline for between in step.reroutes]


def fresh_delay_s(trace: Trace, between: tuple[str, str], t_ns: int) -> float | None:
    """From a moment until every stream between two nodes has delivered a message that was published since.

    Returns:
        Seconds; None if a stream delivered none until the end, or there is no stream.
    """
    streams = [stream.index for stream in trace.streams if {stream.source, stream.destination} == set(between)]
    first = [_first_fresh_ns(trace, stream, t_ns) for stream in streams]
    known = [at_ns for at_ns in first if at_ns is not None]
    return (max(known) - t_ns) / NS_PER_S if known and len(known) == len(first) else None


def _reroute(trace: Trace, step: Step, between: tuple[str, str]) -> Reroute:
    return Reroute(between, trace.seconds(step.t_ns), fresh_delay_s(trace, between, step.t_ns), step.t_ns)


def _first_fresh_ns(trace: Trace, stream: int, since_ns: int) -> int | None:
    times = (delivery.t_ns for delivery in first_deliveries(trace, stream) if delivery.published_ns >= since_ns)
    return min(times, default=None)
