"""Events of a scenario: what goes wrong, when, and when it is put right."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from netlab.scenario.base import NodeName, StrictModel, Switch
from netlab.scenario.links import Ends
from netlab.scenario.places import Position
from netlab.scenario.quantities import MetresPerSecond, PositiveSeconds, Seconds
from netlab.scenario.words import Words

MOST_CYCLES = 10_000
KINDS = ("outage", "flap", "link", "kill", "deploy", "move", "mark", "hold")


class PathEvent(Ends):
    """An event on what joins two nodes. ``over`` picks the wire or the radio where both join them."""

    over: Literal["wire", "radio"] | None = None


class Outage(PathEvent):
    """Everything between two nodes is lost silently for ``for_s`` seconds; interfaces notice nothing."""

    for_s: PositiveSeconds = Field(alias="for")


class Flap(PathEvent):
    """Down for ``down_s``, up for ``up_s``, over and over until ``until_s`` (scenario time), then up.

    ``carrier``: a wire's cable is pulled, so that interfaces notice; false loses silently. Radios are always silent.
    """

    up_s: PositiveSeconds = Field(alias="up")
    down_s: PositiveSeconds = Field(alias="down")
    until_s: PositiveSeconds = Field(alias="until")
    carrier: Switch = True

    def cycles(self, at_s: float) -> float:
        """How many times the link goes down, for a flap that begins at ``at_s``."""
        return (self.until_s - at_s) / (self.up_s + self.down_s)

    @model_validator(mode="after")
    def _a_cable_has_two_ends(self) -> Self:
        if self.between is None and self.carrier and self.over != "radio" and "carrier" in self.model_fields_set:
            raise ValueError("a cable is pulled for both directions; write between: [a, b], or carrier: false")
        return self


class LinkChange(PathEvent, Words):
    """New words for the path between two nodes; words that are not given stay as they are."""

    @model_validator(mode="after")
    def _changes_something(self) -> Self:
        if not self.given():
            raise ValueError("nothing changes; add a word such as loss: 20%")
        return self


class Kill(StrictModel):
    """SIGKILL to one process of a node."""

    node: NodeName
    process: str


class MoveWords(StrictModel):
    """Put a node elsewhere at once, or send it there with a speed; it leaves its own motion for good."""

    node: NodeName
    to: Position
    speed_mps: MetresPerSecond | None = Field(default=None, alias="speed")


class Event(StrictModel):
    """One entry of `events`: exactly one of ``KINDS``, at ``at_s`` seconds of scenario time."""

    at_s: Seconds = Field(alias="at")
    outage: Outage | None = None
    flap: Flap | None = None
    link: LinkChange | None = None
    kill: Kill | None = None
    restart_s: Seconds | None = Field(default=None, alias="restart")
    deploy: NodeName | None = None
    move: MoveWords | None = None
    mark: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """A moment worth finding again; only the record of it."""
    hold_s: PositiveSeconds | None = Field(default=None, alias="hold")
    """All motion, and a radio's trace, stand still for so long; other events keep their times."""

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        given = [kind for kind in KINDS if getattr(self, "hold_s" if kind == "hold" else kind) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of {', '.join(KINDS)}; found {' and '.join(given) or 'none'}")
        if self.restart_s is not None and self.kill is None:
            raise ValueError(f"restart belongs to kill; remove it beside {given[0]}")
        if self.flap is not None and self.flap.until_s <= self.at_s:
            raise ValueError("until is not after at; both are scenario times")
        if self.flap is not None and self.flap.cycles(self.at_s) > MOST_CYCLES:
            raise ValueError(f"the link would flap more than {MOST_CYCLES:,} times; make up and down longer")
        return self

    @property
    def path(self) -> Outage | Flap | LinkChange | None:
        """The part of the event that names two nodes, or None."""
        return self.outage or self.flap or self.link
