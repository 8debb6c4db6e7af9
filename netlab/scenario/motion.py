"""Motion of a scenario's nodes: a file of another program, and what nodes and events say, as values of the world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, WithJsonSchema, model_validator

from netlab.scenario.base import NodeName, Problems, StrictModel
from netlab.scenario.words import read_file
from netlab.world.choreography import Choreography
from netlab.world.imports import ONLY_NODE, TraceFormat, TraceProblems, read_motion
from netlab.world.motion import NEVER_S, Carried, Follow, Motion, Move, Sampled, Walk, Waypoint
from netlab.world.tracks import Track

if TYPE_CHECKING:
    from netlab.scenario.model import Scenario
    from netlab.scenario.nodes import Node

_FORMATS = {
    ".csv": TraceFormat.CSV,
    ".movements": TraceFormat.BONNMOTION,
    ".ns_movements": TraceFormat.NS2,
    ".tcl": TraceFormat.NS2,
}


class _TraceFile(StrictModel):
    """A file that another program has written; what it says is kept by the names that it uses."""

    file: str
    format: Literal["ns2", "bonnmotion", "bonnmotion_3d", "csv"] | None = None
    _tracks: dict[str, Sampled] = PrivateAttr(default_factory=dict)

    @property
    def _trace_format(self) -> TraceFormat:
        known = TraceFormat(self.format) if self.format else _FORMATS.get(PurePath(self.file).suffix)
        if known is None:
            raise ValueError(
                f"'{self.file}' does not tell its format; add format: ns2, bonnmotion, bonnmotion_3d or csv"
            )
        return known

    def _read(self, info: ValidationInfo) -> dict[str, Sampled]:
        try:
            return read_motion(read_file(info, self.file), self._trace_format)
        except TraceProblems as error:
            raise Problems(f"{self.file}:{problem}" for problem in error.problems) from None


class MotionFile(_TraceFile):
    """Motion of several nodes. ``nodes`` are the names of the file's nodes 0, 1, ... where it only counts them."""

    nodes: Annotated[tuple[NodeName, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _named_tracks(self, info: ValidationInfo) -> Self:
        tracks, names_itself = self._read(info), self._trace_format is TraceFormat.CSV
        if names_itself and self.nodes is not None:
            raise ValueError(f"'{self.file}' names its nodes itself; remove nodes")
        if ONLY_NODE in tracks:
            raise ValueError(
                f"'{self.file}' does not say whose motion it is; add a column node, or give it to one node"
            )
        self._tracks = tracks if names_itself else self._named(tracks)
        return self

    @property
    def tracks(self) -> dict[str, Sampled]:
        """The motion of each node that the file speaks of."""
        return self._tracks

    def _named(self, tracks: dict[str, Sampled]) -> dict[str, Sampled]:
        if self.nodes is None:
            raise ValueError(f"'{self.file}' counts its nodes; add nodes: [name of node 0, name of node 1, ...]")
        unknown = [number for number in tracks if int(number) >= len(self.nodes)]
        if unknown:
            raise ValueError(f"'{self.file}' has a node {unknown[0]}, and nodes names {len(self.nodes)} from 0 on")
        return {self.nodes[int(number)]: track for number, track in tracks.items()}


def _file_node(value: object) -> object:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class NodeMotion(_TraceFile):
    """Motion of one node: the file's only one, or the one that ``node`` picks by the file's name or number of it."""

    node: Annotated[str, BeforeValidator(_file_node), WithJsonSchema({"type": ["string", "integer"]})] | None = None

    @model_validator(mode="after")
    def _one_track(self, info: ValidationInfo) -> Self:
        tracks = self._read(info)
        if not tracks:
            raise ValueError(f"'{self.file}' says nothing of any node")
        if self.node is None and len(tracks) > 1:
            raise ValueError(f"'{self.file}' has {len(tracks)} nodes; add node: with one of {_some(tracks)}")
        if self.node is not None and self.node not in tracks:
            raise ValueError(f"'{self.file}' has no node '{self.node}'; it has {_some(tracks)}")
        self._tracks = {"": tracks[next(iter(tracks)) if self.node is None else self.node]}
        return self

    @property
    def track(self) -> Sampled:
        """Where the node is when."""
        return self._tracks[""]


def _some(names: Iterable[str]) -> str:
    shown = list(names)
    return ", ".join(name or "one without a name" for name in shown[:10]) + (", ..." if len(shown) > 10 else "")


def choreography(scenario: Scenario, moves: tuple[Move, ...] = ()) -> Choreography:
    """All motion that the scenario describes, with ``moves`` besides."""
    terrain = None if scenario.terrain is None else scenario.terrain.tunnel_map
    return Choreography(motions(scenario), (*scheduled_moves(scenario), *moves), terrain)


def tracks(scenario: Scenario, moves: tuple[Move, ...] = ()) -> list[Track]:
    """Where each node is when, in the order of the scenario. Raises MotionError for a move that cannot be."""
    return choreography(scenario, moves).tracks()


def earlier(at_s: float, holds: Sequence[tuple[float, float]]) -> float:
    """How far motion has come at a scenario time: less the holds (from, for, sorted) until then."""
    return at_s - sum(min(for_s, at_s - from_s) for from_s, for_s in holds if from_s < at_s)


def later(motion_s: float, holds: Sequence[tuple[float, float]]) -> float:
    """The scenario time at which motion has come to ``motion_s``: the inverse of :func:`earlier`."""
    at_s = motion_s
    for from_s, for_s in holds:
        at_s += for_s if from_s < at_s else 0.0
    return at_s


def motions(scenario: Scenario) -> dict[str, Motion]:
    """How every node means to move, before any `move` event."""
    recorded = scenario.motion.tracks if scenario.motion is not None else {}
    holds = scenario.holds
    deployed = {
        event.deploy: earlier(event.at_s, holds) for event in reversed(scenario.events) if event.deploy is not None
    }
    return {
        name: recorded.get(name) or _motion(node, deployed.get(name, NEVER_S)) for name, node in scenario.nodes.items()
    }


def scheduled_moves(scenario: Scenario) -> tuple[Move, ...]:
    """The `move` events, in the order of the file."""
    holds = scenario.holds
    return tuple(
        Move(earlier(event.at_s, holds), event.move.node, event.move.to, event.move.speed_mps)
        for event in scenario.events
        if event.move is not None
    )


def _motion(node: Node, deployed_at_s: float) -> Motion:
    if node.motion is not None:
        return node.motion.track
    if node.follow is not None:
        assert node.distance_m is not None  # the model: both or neither
        return Follow(node.follow, node.distance_m)
    if node.carried_by is not None:
        return Carried(node.carried_by, deployed_at_s)
    first, *rest = node.waypoints or (None,)
    if first is None or "position" in node.model_fields_set:
        start_m, pause_s, rest = node.position, 0.0, list(node.waypoints)
    else:
        start_m, pause_s = first.position, first.pause_s
    waypoints = []
    for words in rest:
        assert words is not None
        speed_mps = words.speed_mps or node.speed_mps
        assert speed_mps is not None  # the model: a speed for every leg
        waypoints.append(Waypoint(words.position, speed_mps, words.pause_s))
    return Walk(start_m, tuple(waypoints), pause_s, node.heading_deg)
