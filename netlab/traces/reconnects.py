"""How long after each restoration the first fresh application message came through."""

from __future__ import annotations

from dataclasses import dataclass

from netlab.traces.model import NS_PER_S, Step, Stream, Trace
from netlab.traces.streams import first_deliveries


@dataclass(frozen=True, slots=True)
class Reconnect:
    """One restoration. ``first_delivery_s`` and ``delay_s`` are None if nothing fresh came through until the end."""

    between: tuple[str, str]
    restored_at_s: float
    first_delivery_s: float | None
    delay_s: float | None
    restored_ns: int


def reconnects(trace: Trace) -> list[Reconnect]:
    """One entry per restoration, in the order of time.

    Fresh is a message published after the restoration, in either direction between the two nodes, or the newest one
    that a stream with ``keep: latest`` kept over the outage. Probes, beacons and older messages do not count. Nodes of
    a mesh are restored when a path joins them again.
    """
    return [
        _reconnect(trace, step, between)
        for step in trace.timeline
        for between in (*([step.restores] if step.restores else []), *step.rejoins)
    ]


def _reconnect(trace: Trace, step: Step, between: tuple[str, str]) -> Reconnect:
    times = [
        time
        for stream in trace.streams
        if {stream.source, stream.destination} == set(between)
        if (time := _first_fresh_ns(trace, stream, step.t_ns)) is not None
    ]
    first = min(times, default=None)
    return Reconnect(
        between,
        restored_at_s=trace.seconds(step.t_ns),
        first_delivery_s=None if first is None else trace.seconds(first),
        delay_s=None if first is None else (first - step.t_ns) / NS_PER_S,
        restored_ns=step.t_ns,
    )


def _first_fresh_ns(trace: Trace, stream: Stream, restored_ns: int) -> int | None:
    before = [entry for entry in trace.published.get(stream.index, []) if entry.t_ns < restored_ns]
    kept = before[-1].seq if stream.keeps_latest and before else None
    times = (
        delivery.t_ns
        for delivery in first_deliveries(trace, stream.index)
        if delivery.t_ns >= restored_ns and (delivery.published_ns >= restored_ns or delivery.seq == kept)
    )
    return min(times, default=None)
