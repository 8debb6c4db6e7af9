"""How well each stream fared: latency, deliveries, duplicates, goodput, gaps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from netlab.traces.model import NS_PER_S, Delivery, Stream, Trace


@dataclass(frozen=True, slots=True)
class Latency:
    """One-way latency of delivered messages, in seconds: publish call to first receipt by the subscriber."""

    p50: float
    p90: float
    p99: float
    max: float


@dataclass(frozen=True, slots=True)
class StreamReport:
    """The figures of one stream.

    ``sent`` counts publish calls, refused ones included; ``delivered`` distinct messages. ``goodput_bps`` counts
    distinct payload bits delivered within the duration. ``longest_gap_s`` is the longest time between successive
    deliveries or from the last one to the end of the duration; the whole duration if nothing came. ``latency`` is None
    if nothing came.
    """

    stream: Stream
    sent: int
    refused: int
    delivered: int
    duplicates: int
    latency: Latency | None
    goodput_bps: float
    longest_gap_s: float


def percentile(values: Sequence[float], ratio: float) -> float:
    """Nearest rank: the smallest of ``values`` such that at least ``ratio`` of them are not above it.

    Args:
        values: Sorted, not empty.
        ratio: 0..1.

    Raises:
        ValueError: No values, or ``ratio`` outside 0..1.
    """
    if not values or not 0 <= ratio <= 1:
        raise ValueError(f"no {ratio} percentile of {len(values)} values")
    return values[max(math.ceil(ratio * len(values)), 1) - 1]


def first_deliveries(trace: Trace, stream: int) -> list[Delivery]:
    """The first receipt of each message, in the order of receipt."""
    first: dict[int, Delivery] = {}
    for delivery in trace.delivered.get(stream, []):
        first.setdefault(delivery.seq, delivery)
    return list(first.values())


def latencies_s(trace: Trace, stream: int) -> list[float]:
    """Latency of every delivered message, sorted."""
    return sorted(delivery.latency_s for delivery in first_deliveries(trace, stream))


def stream_report(trace: Trace, stream: Stream) -> StreamReport:
    """Answer all questions about one stream."""
    published = trace.published.get(stream.index, [])
    received = trace.delivered.get(stream.index, [])
    distinct = first_deliveries(trace, stream.index)
    values = latencies_s(trace, stream.index)
    in_time = [delivery for delivery in distinct if delivery.t_ns < trace.end_ns]
    return StreamReport(
        stream,
        sent=len(published),
        refused=sum(not entry.accepted for entry in published),
        delivered=len(distinct),
        duplicates=len(received) - len(distinct),
        latency=Latency(*(percentile(values, ratio) for ratio in (0.5, 0.9, 0.99, 1.0))) if values else None,
        goodput_bps=sum(delivery.size_bytes for delivery in in_time) * 8 / trace.duration_s
        if trace.duration_s
        else 0.0,
        longest_gap_s=longest_gap(trace, stream.index)[0],
    )


def stream_reports(trace: Trace) -> list[StreamReport]:
    """All streams, in scenario order."""
    return [stream_report(trace, stream) for stream in trace.streams]


def longest_gap(trace: Trace, stream: int) -> tuple[float, int]:
    """Return (length in seconds, when it began) of a stream's longest gap."""
    times = sorted(delivery.t_ns for delivery in first_deliveries(trace, stream))
    if not times:
        return trace.duration_s, trace.t0_ns
    ends = [*times[1:], max(trace.end_ns, times[-1])]
    gap_ns, start_ns = max((end - start, start) for start, end in zip(times, ends, strict=True))
    return gap_ns / NS_PER_S, start_ns
