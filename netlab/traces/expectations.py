"""A scenario's ``expect`` against a trace: one result per bound, each failure with its story."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from netlab.scenario.expect import (
    AnyExpectation,
    DeliveredExpectation,
    DuplicatesExpectation,
    GoodputExpectation,
    LatencyExpectation,
    LongestGapExpectation,
    PriorityInversionsExpectation,
    ReconnectExpectation,
    RerouteExpectation,
    RetransmissionsExpectation,
    StreamQuery,
)
from netlab.traces.explain import around, milliseconds, rate
from netlab.traces.inversions import inversions
from netlab.traces.model import Stream, Trace
from netlab.traces.reconnects import Reconnect, reconnects
from netlab.traces.reroutes import Reroute, reroutes
from netlab.traces.retransmissions import retransmissions
from netlab.traces.streams import first_deliveries, longest_gap, percentile, stream_report


@dataclass(frozen=True, slots=True)
class ExpectationResult:
    """One bound. ``measured`` and ``limit`` are in seconds, ratios, bit/s or counts; None: nothing to measure.

    ``explanation`` is empty for a bound that was met, else several lines for a person.
    """

    name: str
    passed: bool
    measured: float | None
    limit: float
    explanation: str = ""


@dataclass(frozen=True, slots=True)
class _Measured:
    """One stream's answer: the value, whether it meets the bound, when it went wrong and what to say of it."""

    value: float | None
    passed: bool
    t_ns: int
    what: str


def evaluate(expect: Iterable[AnyExpectation], trace: Trace) -> list[ExpectationResult]:
    """Answer every bound of a scenario's expectations, in their order."""
    results: list[ExpectationResult] = []
    for expectation in expect:
        match expectation:
            case LatencyExpectation():
                results += _latency(expectation, trace)
            case ReconnectExpectation():
                results.append(_reconnect(expectation, trace))
            case RerouteExpectation():
                results.append(_reroute(expectation, trace))
            case PriorityInversionsExpectation():
                results.append(_inversions(expectation, trace))
            case RetransmissionsExpectation():
                results.append(_retransmissions(expectation, trace))
            case DeliveredExpectation():
                results.append(_delivered(expectation, trace))
            case GoodputExpectation():
                results.append(_goodput(expectation, trace))
            case LongestGapExpectation():
                results.append(_longest_gap(expectation, trace))
            case DuplicatesExpectation():
                results.append(_duplicates(expectation, trace))
    return results


def _latency(expectation: LatencyExpectation, trace: Trace) -> list[ExpectationResult]:
    bounds = {
        "p50": (0.5, expectation.p50_s),
        "p90": (0.9, expectation.p90_s),
        "p99": (0.99, expectation.p99_s),
        "max": (1.0, expectation.max_s),
    }

    def result(word: str, ratio: float, limit_s: float) -> ExpectationResult:
        name = f"latency of {_named(expectation.latency)} {word} <= {milliseconds(limit_s)}"

        def measure(stream: Stream) -> _Measured:
            deliveries = sorted(
                first_deliveries(trace, stream.index), key=lambda entry: entry.t_ns - entry.published_ns
            )
            if not deliveries:
                return _Measured(None, False, trace.end_ns, f"{stream}: nothing was delivered")
            value = percentile([(entry.t_ns - entry.published_ns) / 1e9 for entry in deliveries], ratio)
            worst = deliveries[-1]
            took = milliseconds((worst.t_ns - worst.published_ns) / 1e9)
            what = f"{stream}: slowest is #{worst.seq}, {took} after its publication ({word} {milliseconds(value)})"
            return _Measured(value, value <= limit_s, worst.t_ns, what)

        return _over_streams(trace, name, expectation.latency, limit_s, measure, worst_is_highest=True)

    return [result(word, ratio, limit_s) for word, (ratio, limit_s) in bounds.items() if limit_s is not None]


def _delay_or_never(entry: Reconnect | Reroute) -> float:
    return float("inf") if entry.delay_s is None else entry.delay_s


def _reconnect(expectation: ReconnectExpectation, trace: Trace) -> ExpectationResult:
    between, limit_s = set(expectation.reconnect.between), expectation.max_s
    name = f"reconnect of {'-'.join(expectation.reconnect.between)} <= {milliseconds(limit_s)}"
    entries = [entry for entry in reconnects(trace) if set(entry.between) == between]
    if not entries:
        what = "nothing was restored between them in this run"
        return ExpectationResult(name, False, None, limit_s, around(trace, trace.end_ns, what))
    worst = max(entries, key=_delay_or_never)
    passed = worst.delay_s is not None and worst.delay_s <= limit_s
    if passed:
        return ExpectationResult(name, True, worst.delay_s, limit_s)
    what = f"restored; the first fresh message came {milliseconds(worst.delay_s)} later"
    if worst.delay_s is None:
        what = "restored; no message published since then came through, in either direction"
    return ExpectationResult(name, False, worst.delay_s, limit_s, around(trace, worst.restored_ns, what))


def _reroute(expectation: RerouteExpectation, trace: Trace) -> ExpectationResult:
    between, limit_s = set(expectation.reroute.between), expectation.max_s
    name = f"reroute of {'-'.join(expectation.reroute.between)} <= {milliseconds(limit_s)}"
    entries = [entry for entry in reroutes(trace) if set(entry.between) == between]
    if not entries:
        what = "no cut in this run left them another path"
        return ExpectationResult(name, False, None, limit_s, around(trace, trace.end_ns, what))
    worst = max(entries, key=_delay_or_never)
    if worst.delay_s is not None and worst.delay_s <= limit_s:
        return ExpectationResult(name, True, worst.delay_s, limit_s)
    what = f"cut; on another path, the first message published since came {milliseconds(worst.delay_s)} later"
    if worst.delay_s is None:
        what = "cut; a stream between them got nothing through that was published since, although a path was left"
    return ExpectationResult(name, False, worst.delay_s, limit_s, around(trace, worst.cut_ns, what))


def _inversions(expectation: PriorityInversionsExpectation, trace: Trace) -> ExpectationResult:
    node = expectation.priority_inversions.at
    found = inversions(trace, node)
    explanation = ""
    if len(found) > expectation.max_count:
        first = found[expectation.max_count]
        what = (
            f"{node}: fragment {first.fragment.index + 1}/{first.fragment.count} of priority {first.fragment.priority} "
            f"left while {first.stream} #{first.seq} of priority {first.stream.priority} had waited "
            f"{milliseconds(first.waited_s)}"
        )
        explanation = around(trace, first.fragment.t_ns, what)
    return _count(f"priority inversions at {node}", len(found), expectation.max_count, explanation)


def _retransmissions(expectation: RetransmissionsExpectation, trace: Trace) -> ExpectationResult:
    node = expectation.retransmissions.at
    found = retransmissions(trace, node)
    explanation = ""
    if len(found) > expectation.max_count:
        first = found[expectation.max_count]
        what = f"{node}: fragment {first.index + 1}/{first.count} of message {first.message_id} left again"
        explanation = around(trace, first.t_ns, what)
    return _count(f"retransmissions at {node}", len(found), expectation.max_count, explanation)


def _delivered(expectation: DeliveredExpectation, trace: Trace) -> ExpectationResult:
    limit = expectation.min_ratio

    def measure(stream: Stream) -> _Measured:
        report = stream_report(trace, stream)
        if not report.sent:
            return _Measured(None, False, trace.end_ns, f"{stream}: nothing was published")
        received = {entry.seq for entry in trace.delivered.get(stream.index, [])}
        missing = [entry for entry in trace.published[stream.index] if entry.seq not in received]
        what = f"{stream}: {report.delivered} of {report.sent} delivered, {report.refused} refused"
        what += f"; the first that is missing is #{missing[0].seq}" if missing else ""
        when = missing[0].t_ns if missing else trace.end_ns
        ratio = report.delivered / report.sent
        return _Measured(ratio, ratio >= limit, when, what)

    name = f"delivered of {_named(expectation.delivered)} >= {limit:.4g}"
    return _over_streams(trace, name, expectation.delivered, limit, measure, worst_is_highest=False)


def _goodput(expectation: GoodputExpectation, trace: Trace) -> ExpectationResult:
    limit_bps = expectation.min_bps

    def measure(stream: Stream) -> _Measured:
        value = stream_report(trace, stream).goodput_bps
        return _Measured(value, value >= limit_bps, trace.end_ns, f"{stream}: {rate(value)} over the whole duration")

    name = f"goodput of {_named(expectation.goodput)} >= {rate(limit_bps)}"
    return _over_streams(trace, name, expectation.goodput, limit_bps, measure, worst_is_highest=False)


def _longest_gap(expectation: LongestGapExpectation, trace: Trace) -> ExpectationResult:
    limit_s = expectation.max_s

    def measure(stream: Stream) -> _Measured:
        value, start_ns = longest_gap(trace, stream.index)
        what = f"{stream}: nothing was delivered for the next {milliseconds(value)}"
        return _Measured(value, value <= limit_s, start_ns, what)

    name = f"longest gap of {_named(expectation.longest_gap)} <= {milliseconds(limit_s)}"
    return _over_streams(trace, name, expectation.longest_gap, limit_s, measure, worst_is_highest=True)


def _duplicates(expectation: DuplicatesExpectation, trace: Trace) -> ExpectationResult:
    limit = expectation.max_count

    def measure(stream: Stream) -> _Measured:
        seen: set[int] = set()
        again = []
        for entry in trace.delivered.get(stream.index, []):
            if entry.seq in seen:
                again.append(entry)
            seen.add(entry.seq)
        when, first = (again[0].t_ns, f", the first is #{again[0].seq}") if again else (trace.end_ns, "")
        return _Measured(len(again), len(again) <= limit, when, f"{stream}: {len(again)} delivered again{first}")

    name = f"duplicates of {_named(expectation.duplicates)} <= {limit}"
    return _over_streams(trace, name, expectation.duplicates, limit, measure, worst_is_highest=True)


def _over_streams(
    trace: Trace,
    name: str,
    query: StreamQuery,
    limit: float,
    measure: Callable[[Stream], _Measured],
    *,
    worst_is_highest: bool,
) -> ExpectationResult:
    """Every stream that the query means must meet the bound; the worst one is reported."""
    answers = [measure(stream) for stream in trace.streams if _matches(query, stream)]
    if not answers:
        what = "no such stream in this run"
        return ExpectationResult(name, False, None, limit, around(trace, trace.end_ns, what))

    def badness(answer: _Measured) -> tuple[bool, bool, float]:
        value = answer.value or 0.0
        return (not answer.passed, answer.value is None, value if worst_is_highest else -value)

    worst = max(answers, key=badness)
    explanation = "" if worst.passed else around(trace, worst.t_ns, worst.what)
    return ExpectationResult(name, worst.passed, worst.value, limit, explanation)


def _count(what: str, measured: int, limit: int, explanation: str) -> ExpectationResult:
    return ExpectationResult(f"{what} <= {limit}", measured <= limit, measured, limit, explanation)


def _matches(query: StreamQuery, stream: Stream) -> bool:
    return (
        stream.topic == query.topic and query.from_ in (None, stream.source) and query.to in (None, stream.destination)
    )


def _named(query: StreamQuery) -> str:
    ends = f" {query.from_ or '*'}->{query.to or '*'}" if query.from_ or query.to else ""
    return f"{query.topic}{ends}"
