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

    Each direction finds its own way: the delay is that of the slower one, by the first of its streams that delivers. A
    stream that sends seldom, or waits behind more urgent ones, says nothing of the way where another one shows it. What
    was published before the cut does not count, wherever it was; so frames that were past the cut do not either.
    """
    return [_reroute(trace, step, between) for step in trace.timeline for between in step.reroutes]


def fresh_delay_s(trace: Trace, between: tuple[str, str], t_ns: int) -> float | None:
    """From a moment until a message that was published since has arrived in each direction that has streams.

    Returns:
        Seconds; None if a direction delivered none until the end, or there is no stream.
    """
    a, b = between
    directions = [_first_fresh_ns(trace, *ends, t_ns) for ends in ((a, b), (b, a)) if _streams(trace, *ends)]
    known = [at_ns for at_ns in directions if at_ns is not None]
    return (max(known) - t_ns) / NS_PER_S if known and len(known) == len(directions) else None


def _reroute(trace: Trace, step: Step, between: tuple[str, str]) -> Reroute:
    return Reroute(between, trace.seconds(step.t_ns), fresh_delay_s(trace, between, step.t_ns), step.t_ns)


def _streams(trace: Trace, source: str, destination: str) -> list[int]:
    return [s.index for s in trace.streams if (s.source, s.destination) == (source, destination)]


def _first_fresh_ns(trace: Trace, source: str, destination: str, since_ns: int) -> int | None:
    times = (
        delivery.t_ns
        for stream in _streams(trace, source, destination)
        for delivery in first_deliveries(trace, stream)
        if delivery.published_ns >= since_ns
    )
    return min(times, default=None)
