"""The expectations of a run as its capture holds them, each with its evidence: the figure, and the worst instance.

Values only. An expectation is read from the scenario's text in the capture and from what ``--set`` changed of it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from netlab.errors import ScenarioError
from netlab.scenario.document import Document
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
from netlab.scenario.overrides import apply_overrides
from netlab.scenario.yaml_source import read_yaml
from netlab.traces.expectations import ExpectationResult, evaluate
from netlab.traces.explain import milliseconds, rate
from netlab.traces.inversions import inversions
from netlab.traces.model import Stream, Trace
from netlab.traces.reconnects import Reconnect, reconnects
from netlab.traces.reroutes import Reroute, reroutes
from netlab.traces.retransmissions import retransmissions
from netlab.traces.streams import first_deliveries, longest_gap, stream_report

_T = TypeVar("_T", Reconnect, Reroute)
_EXPECTATIONS: TypeAdapter[tuple[AnyExpectation, ...]] = TypeAdapter(tuple[AnyExpectation, ...])


@dataclass(frozen=True, slots=True)
class Instance:
    """The worst that happened: when (scenario time; None: at no one time), what, and how long a message took."""

    at_s: float | None
    text: str
    latency_s: float | None = None


@dataclass(frozen=True, slots=True)
class Evidence:
    """One bound. ``number`` marks it on the plots, ``plot`` is the section that shows it."""

    number: int
    result: ExpectationResult
    plot: str
    worst: Instance | None

    @property
    def measured(self) -> str:
        """The figure in the unit of its limit."""
        return _figure(self.result, self.result.measured)

    @property
    def limit(self) -> str:
        """The bound in its unit."""
        return _figure(self.result, self.result.limit)

    @property
    def share_of_limit(self) -> float | None:
        """The figure over its limit; above 1 is more than allowed, or, of a least value, more than asked for."""
        measured, limit = self.result.measured, self.result.limit
        return None if measured is None else measured / limit if limit else float(measured > 0)


def expectations_of(metadata: Mapping[str, str]) -> tuple[AnyExpectation, ...]:
    """Return the expectations of the run that wrote a capture; none if its scenario's text cannot be read."""
    try:
        document = read_yaml(metadata.get("scenario", ""), name="scenario")
        changed = json.loads(metadata.get("overrides", "[]"))
        apply_overrides(document, [text for text in changed if str(text).lstrip().startswith("expect")])
        return _EXPECTATIONS.validate_python(_expect(document))
    except (ScenarioError, ValidationError, ValueError):
        return ()


def _expect(document: Document) -> object:
    found = document.data.get("expect")
    return tuple(found) if isinstance(found, list) else ()


def evidence(expect: tuple[AnyExpectation, ...], trace: Trace) -> list[Evidence]:
    """Answer every bound, in the order of the scenario."""
    found: list[Evidence] = []
    for expectation in expect:
        plot, worst = _WORST[type(expectation)]
        instance = worst(expectation, trace)
        for result in evaluate([expectation], trace):
            found.append(Evidence(len(found) + 1, result, plot, instance))
    return found


def _figure(result: ExpectationResult, value: float | None) -> str:
    if value is None:
        return "nothing to measure"
    if result.name.endswith((" ms", " s")):
        return milliseconds(value)
    if result.name.endswith("bit/s"):
        return rate(value)
    return f"{value:.2%}" if result.name.startswith("delivered") else f"{value:.0f}"


def _streams(query: StreamQuery, trace: Trace) -> list[Stream]:
    return [
        stream
        for stream in trace.streams
        if stream.topic == query.topic
        and query.from_ in (None, stream.source)
        and query.to in (None, stream.destination)
    ]


def _slowest(expectation: LatencyExpectation, trace: Trace) -> Instance | None:
    streams = {stream.index: stream for stream in _streams(expectation.latency, trace)}
    deliveries = [delivery for index in streams for delivery in first_deliveries(trace, index)]
    if not deliveries:
        return None
    worst = max(deliveries, key=lambda delivery: delivery.latency_s)
    text = f"{streams[worst.stream]} #{worst.seq} took {milliseconds(worst.latency_s)}"
    return Instance(trace.seconds(worst.published_ns), text, worst.latency_s)


def _reconnect(expectation: ReconnectExpectation, trace: Trace) -> Instance | None:
    worst = _slowest_between(reconnects(trace), expectation.reconnect.between)
    if worst is None:
        return None
    took = "no fresh message came" if worst.delay_s is None else f"a fresh message after {milliseconds(worst.delay_s)}"
    return Instance(worst.restored_at_s, f"restored; {took}")


def _reroute(expectation: RerouteExpectation, trace: Trace) -> Instance | None:
    worst = _slowest_between(reroutes(trace), expectation.reroute.between)
    if worst is None:
        return None
    took = "no fresh message came" if worst.delay_s is None else f"another path after {milliseconds(worst.delay_s)}"
    return Instance(worst.cut_at_s, f"cut; {took}")


def _slowest_between(entries: Sequence[_T], between: tuple[str, str]) -> _T | None:
    those = [entry for entry in entries if set(entry.between) == set(between)]
    return max(those, key=lambda entry: float("inf") if entry.delay_s is None else entry.delay_s, default=None)


def _missing(expectation: DeliveredExpectation, trace: Trace) -> Instance | None:
    lost: list[tuple[int, str]] = []
    for stream in _streams(expectation.delivered, trace):
        received = {delivery.seq for delivery in trace.delivered.get(stream.index, [])}
        entries = [entry for entry in trace.published.get(stream.index, []) if entry.seq not in received]
        lost += [(entry.t_ns, f"{stream} #{entry.seq} never came") for entry in entries]
    if not lost:
        return None
    first = min(lost)
    more = f", the first of {len(lost)}" if len(lost) > 1 else ""
    return Instance(trace.seconds(first[0]), first[1] + more)


def _inverted(expectation: PriorityInversionsExpectation, trace: Trace) -> Instance | None:
    found = inversions(trace, expectation.priority_inversions.at)
    if not found:
        return None
    worst = max(found, key=lambda inversion: inversion.waited_s)
    text = f"{worst.stream} #{worst.seq} had waited {milliseconds(worst.waited_s)} when priority "
    return Instance(trace.seconds(worst.fragment.t_ns), f"{text}{worst.fragment.priority} left")


def _sent_again(expectation: RetransmissionsExpectation, trace: Trace) -> Instance | None:
    found = retransmissions(trace, expectation.retransmissions.at)
    return Instance(trace.seconds(found[0].t_ns), f"the first of {len(found)} left again") if found else None


def _least_goodput(expectation: GoodputExpectation, trace: Trace) -> Instance | None:
    reports = [stream_report(trace, stream) for stream in _streams(expectation.goodput, trace)]
    if not reports:
        return None
    worst = min(reports, key=lambda report: report.goodput_bps)
    return Instance(None, f"{worst.stream} got {rate(worst.goodput_bps)}")


def _gap(expectation: LongestGapExpectation, trace: Trace) -> Instance | None:
    gaps = [(longest_gap(trace, stream.index), stream) for stream in _streams(expectation.longest_gap, trace)]
    if not gaps:
        return None
    (length_s, start_ns), stream = max(gaps, key=lambda gap: gap[0])
    return Instance(trace.seconds(start_ns), f"{stream}: nothing for {milliseconds(length_s)}")


def _again(expectation: DuplicatesExpectation, trace: Trace) -> Instance | None:
    for stream in _streams(expectation.duplicates, trace):
        seen: set[int] = set()
        for delivery in trace.delivered.get(stream.index, []):
            if delivery.seq in seen:
                return Instance(trace.seconds(delivery.t_ns), f"{stream} #{delivery.seq} came again")
            seen.add(delivery.seq)
    return None


#: By kind of expectation: the section whose plot shows it, and who finds the worst instance.
_WORST: Mapping[type, tuple[str, Callable[..., Instance | None]]] = {
    LatencyExpectation: ("latency", _slowest),
    ReconnectExpectation: ("reconnects", _reconnect),
    RerouteExpectation: ("latency", _reroute),
    DeliveredExpectation: ("latency", _missing),
    PriorityInversionsExpectation: ("latency", _inverted),
    RetransmissionsExpectation: ("message", _sent_again),
    GoodputExpectation: ("volume", _least_goodput),
    LongestGapExpectation: ("latency", _gap),
    DuplicatesExpectation: ("streams", _again),
}
