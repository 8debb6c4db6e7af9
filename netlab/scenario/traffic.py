"""Traffic of a scenario: what is published by whom to whom, and the numbered streams that come of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

from netlab.scenario.base import NodeName, StrictModel, Switch, Topic, node_name
from netlab.scenario.quantities import FREQUENCY, SIZE, PositiveSeconds, Quantity
from netlab.scenario.rate_limit import RateLimit

#: The traffic processes open each payload with a header of this size, which carries stream, number and time.
HEADER_BYTES = 18
#: The destination that means every other node with udp_mesh.
ALL = "all"
_MOST_BYTES = 16 * 1024 * 1024


def _whole(value: float) -> int:
    if value != int(value):
        raise ValueError(f"{value} bytes is impossible; give a whole number of bytes")
    return int(value)


MessageSize = Annotated[
    int,
    Quantity(SIZE, minimum=HEADER_BYTES, maximum=_MOST_BYTES),
    AfterValidator(_whole),  # behind Quantity, which replaces what stands before it
]


def _destinations(value: object) -> tuple[object, ...]:
    names = tuple(value) if isinstance(value, (list, tuple)) else (value,)
    if not names:
        raise ValueError("the list is empty; name a node, several, or write all")
    if ALL in names and len(names) > 1:
        raise ValueError("all stands alone; write to: all, or name the nodes")
    if len(set(map(str, names))) < len(names):
        raise ValueError("a node is named twice; name each once")
    return names


Destination = Annotated[str, BeforeValidator(lambda value: value if value == ALL else node_name(value))]
Destinations = Annotated[
    tuple[Destination, ...],
    BeforeValidator(_destinations),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1}]}),
]


class Traffic(StrictModel):
    """One source: a message of ``size_bytes`` on ``topic`` every 1 / ``rate_hz`` seconds, for the whole duration.

    ``to`` names the destinations, or is ``(ALL,)``.
    """

    from_: NodeName = Field(alias="from")
    to: Destinations
    topic: Topic
    priority: Annotated[int, Field(ge=0, le=255)] = 5
    size_bytes: MessageSize = Field(alias="size")
    rate_hz: Annotated[float, Quantity(FREQUENCY, maximum=10_000.0, above_minimum=True)] = Field(alias="rate")
    reliability: Literal["reliable", "best_effort"] = "reliable"
    keep: Literal["all", "latest"] = "all"
    lifetime_s: PositiveSeconds | None = Field(default=None, alias="lifetime")
    offline: Literal["discard", "latest", "store"] = "discard"
    redundancy: Annotated[int, Field(ge=1, le=8)] = 1
    rate_limit: RateLimit | None = None
    compress: Switch = False

    @property
    def topic_settings(self) -> tuple[object, ...]:
        """What belongs to the topic at its sender, not to the single entry."""
        return (
            self.priority,
            self.reliability,
            self.keep,
            self.lifetime_s,
            self.offline,
            self.redundancy,
            self.rate_limit,
            self.compress,
        )


@dataclass(frozen=True, slots=True)
class Stream:
    """One traffic entry to one destination. Streams are numbered in the order of the scenario.

    ``entry`` is the index of the traffic entry; `to: all` makes one stream per destination of the same entry.
    """

    index: int
    entry: int
    source: str
    destination: str
    topic: str
    priority: int
