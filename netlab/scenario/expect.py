"""Expectations of a scenario: one question to the capture each, with bounds. They are answered in netlab.traces."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

from pydantic import Discriminator, Field, Tag, model_validator

from netlab.scenario.base import NodeName, StrictModel, Topic
from netlab.scenario.quantities import BitsPerSecond, Ratio, Seconds

Count = Annotated[int, Field(ge=0)]


class StreamQuery(StrictModel):
    """The streams of ``topic``, narrowed by source and destination where given; each must meet the bound."""

    topic: Topic
    from_: NodeName | None = Field(default=None, alias="from")
    to: NodeName | None = None


class PairQuery(StrictModel):
    """Two nodes, in either order."""

    between: tuple[NodeName, NodeName]


class NodeQuery(StrictModel):
    """One node."""

    at: NodeName


class Expectation(StrictModel):
    """Base of all expectations; ``question`` is the key that tells them apart in a file."""

    question: ClassVar[str]

    @model_validator(mode="after")
    def _has_a_bound(self) -> Self:
        bounds = [key for key in self.file_keys() if key != self.question]
        if all(getattr(self, name) is None for name in type(self).model_fields if name != self.question):
            raise ValueError(f"there is no bound; add {' or '.join(f'{key}:' for key in bounds)}")
        return self


class LatencyExpectation(Expectation):
    """One-way latency of delivered messages; at least one bound."""

    question: ClassVar[str] = "latency"
    latency: StreamQuery
    p50_s: Seconds | None = Field(default=None, alias="p50")
    p90_s: Seconds | None = Field(default=None, alias="p90")
    p99_s: Seconds | None = Field(default=None, alias="p99")
    max_s: Seconds | None = Field(default=None, alias="max")


class ReconnectExpectation(Expectation):
    """From every restoration between two nodes to the first fresh message."""

    question: ClassVar[str] = "reconnect"
    reconnect: PairQuery
    max_s: Seconds = Field(alias="max")


class RerouteExpectation(Expectation):
    """From every cut that leaves two nodes of a mesh another path to the first message published after it."""

    question: ClassVar[str] = "reroute"
    reroute: PairQuery
    max_s: Seconds = Field(alias="max")


class DeliveredExpectation(Expectation):
    """Distinct messages delivered over messages sent."""

    question: ClassVar[str] = "delivered"
    delivered: StreamQuery
    min_ratio: Ratio = Field(alias="min")


class PriorityInversionsExpectation(Expectation):
    """Less urgent fragments sent while a more urgent message waited."""

    question: ClassVar[str] = "priority_inversions"
    priority_inversions: NodeQuery
    max_count: Count = Field(alias="max")


class GoodputExpectation(Expectation):
    """Distinct payload bits delivered per second of the duration."""

    question: ClassVar[str] = "goodput"
    goodput: StreamQuery
    min_bps: BitsPerSecond = Field(alias="min")


class LongestGapExpectation(Expectation):
    """The longest time between successive deliveries, or from the last one to the end."""

    question: ClassVar[str] = "longest_gap"
    longest_gap: StreamQuery
    max_s: Seconds = Field(alias="max")


class DuplicatesExpectation(Expectation):
    """Messages delivered more than once to the application."""

    question: ClassVar[str] = "duplicates"
    duplicates: StreamQuery
    max_count: Count = Field(alias="max")


class RetransmissionsExpectation(Expectation):
    """Fragments that a node sent again."""

    question: ClassVar[str] = "retransmissions"
    retransmissions: NodeQuery
    max_count: Count = Field(alias="max")


_KINDS: tuple[type[Expectation], ...] = (
    LatencyExpectation,
    ReconnectExpectation,
    RerouteExpectation,
    DeliveredExpectation,
    PriorityInversionsExpectation,
    GoodputExpectation,
    LongestGapExpectation,
    DuplicatesExpectation,
    RetransmissionsExpectation,
)
QUESTIONS = tuple(kind.question for kind in _KINDS)


def _question(value: object) -> str | None:
    if isinstance(value, Expectation):
        return f"<{value.question}>"
    found = [question for question in QUESTIONS if isinstance(value, dict) and question in value]
    return f"<{found[0]}>" if found else None


AnyExpectation = Annotated[
    Annotated[LatencyExpectation, Tag("<latency>")]
    | Annotated[ReconnectExpectation, Tag("<reconnect>")]
    | Annotated[RerouteExpectation, Tag("<reroute>")]
    | Annotated[DeliveredExpectation, Tag("<delivered>")]
    | Annotated[PriorityInversionsExpectation, Tag("<priority_inversions>")]
    | Annotated[GoodputExpectation, Tag("<goodput>")]
    | Annotated[LongestGapExpectation, Tag("<longest_gap>")]
    | Annotated[DuplicatesExpectation, Tag("<duplicates>")]
    | Annotated[RetransmissionsExpectation, Tag("<retransmissions>")],
    Discriminator(
        _question,
        custom_error_type="problem",
        custom_error_message=f"asks no known question; ask one of {', '.join(QUESTIONS)}",
    ),
]
