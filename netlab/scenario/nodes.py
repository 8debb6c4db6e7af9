"""Nodes of a scenario, the processes that run in them, and the settings of the udp_mesh daemon."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, WithJsonSchema, model_validator
from pydantic_core import CoreSchema

from netlab.scenario.base import NodeName, StrictModel, Switch, Topic, not_yet
from netlab.scenario.mesh import BabelSettings, BatmanSettings, FloodSettings, MeshWord
from netlab.scenario.motion import NodeMotion
from netlab.scenario.places import Position, WaypointWords
from netlab.scenario.quantities import (
    DURATION,
    LENGTH,
    RATE,
    RATIO,
    SIZE,
    Degrees,
    MetresPerSecond,
    PositiveSeconds,
    Quantity,
)
from netlab.scenario.radio import NodeRadio
from netlab.scenario.rate_limit import RateLimit
from netlab.scenario.rose import RoseSettings
from netlab.scenario.team_key import TeamKeys
from netlab.scenario.wnet import WnetSettings

BUILTIN_PROCESSES = ("udp_mesh", "rose")


def _whole_bytes(value: object) -> int:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    return int(SIZE.parse(value))


WholeBytes = Annotated[int, BeforeValidator(_whole_bytes), WithJsonSchema({"type": ["integer", "string"]})]


StoreAge = Annotated[float, Quantity(DURATION, minimum=1.0, maximum=2_592_000.0)]
ChannelRate = Annotated[float, Quantity(RATE, minimum=100.0, maximum=1e12)]
BeaconInterval = Annotated[float, Quantity(DURATION, minimum=0.05, maximum=60.0)]


class TopicSettings(StrictModel):
    """The daemon's settings of one topic; what is left out is the daemon's own default."""

    priority: Annotated[int, Field(ge=0, le=255)] | None = None
    reliability: Literal["reliable", "best_effort"] | None = None
    keep: Literal["all", "latest"] | None = None
    lifetime_s: PositiveSeconds | None = Field(default=None, alias="lifetime")
    offline: Literal["discard", "latest", "store"] | None = None
    rate_limit: RateLimit | None = None
    compress: Switch | None = None
    redundancy: Annotated[int, Field(ge=1, le=8)] | None = None


class CarrierSettings(StrictModel):
    """One of the daemon's carriers; what belongs to which kind is checked here as the daemon does."""

    kind: Literal["udp", "udp6", "ethernet", "serial"]
    interfaces: tuple[str, ...] | None = None
    device: str | None = None
    baud: int | None = None
    mtu_bytes: Annotated[WholeBytes, Field(ge=200, le=65_000)] | None = Field(default=None, alias="mtu")
    rate_bps: Annotated[float, Quantity(RATE, minimum=300.0, maximum=1e9)] | None = Field(default=None, alias="rate")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        is_serial = self.kind == "serial"
        if is_serial != (self.device is not None):
            raise ValueError("a serial carrier needs device: /dev/..., and no other has one")
        wrong = ("interfaces",) if is_serial else ("baud", "mtu_bytes", "rate_bps")
        given = [name for name in wrong if getattr(self, name) is not None]
        if given:
            raise ValueError(f"a carrier of kind {self.kind} has no {given[0]}")
        return self


class MeshSettings(StrictModel):
    """Settings of the udp_mesh daemon, at top level or in a node (which wins); None leaves the daemon's default.

    The bounds are the daemon's own (udp_mesh.config), so that a wrong value is found before anything starts.
    """

    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    window: Annotated[int, Field(ge=0, le=100_000)] | None = None
    prioritise: Switch | None = None
    probe: Switch | None = None
    payload_bytes: Annotated[WholeBytes, Field(ge=256, le=65_000)] | None = None
    beacon_interval_s: BeaconInterval | None = Field(default=None, alias="beacon_interval")
    beacon_share: Annotated[float, Quantity(RATIO, minimum=0.0001)] | None = None
    channel_bps: ChannelRate | None = Field(default=None, alias="channel")
    shared_bps: ChannelRate | None = Field(default=None, alias="shared")
    queue_bytes: Annotated[WholeBytes, Field(ge=65_536, le=1 << 30)] | None = None
    dscp: Switch | None = None
    store_bytes: Annotated[WholeBytes, Field(ge=65_536, le=1 << 40)] | None = None
    store_age_s: StoreAge | None = Field(default=None, alias="store_age")
    carriers: Annotated[tuple[CarrierSettings, ...], Field(min_length=1)] | None = None
    topics: dict[Topic, TopicSettings] | None = None
    coordinate: Switch | None = None
    floor: Annotated[float, Quantity(RATIO, maximum=0.5)] | None = None
    key: TeamKeys | None = None
    bridge: Switch | None = None
    neighbours: tuple[str, ...] | None = None
    team: tuple[str, ...] | None = None

    def daemon_config(self) -> dict[str, Any]:
        """The keys that are given, as the daemon's configuration names them (times in seconds, sizes in bytes)."""
        values = self.model_dump(exclude_none=True)
        for topic in values.get("topics", {}).values():
            topic.update(topic.pop("rate_limit", {}))
        return values


class Process(StrictModel):
    """A process of a node: a built-in daemon, or any argv. A file may write just the built-in's name.

    ``ready``: `fd` waits until the process writes to the descriptor in $READY_FD, `started` only for its start.
    """

    builtin: (
        Annotated[
            Literal["udp_mesh", "rose"],
            BeforeValidator(lambda value: not_yet(value, BUILTIN_PROCESSES, (), "process")),
        ]
        | None
    ) = None
    argv: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}$")] = ""
    env: dict[str, str] = Field(default_factory=dict)
    ready: Literal["fd", "started"] = "started"
    restart: Literal["never", "always"] = "never"

    @model_validator(mode="before")
    @classmethod
    def _normal_form(cls, value: object) -> object:
        if isinstance(value, str):
            value = {"builtin": value}
        if not isinstance(value, dict):
            return value
        filled = dict(value)
        argv = filled.get("argv")
        if isinstance(argv, str):
            raise ValueError("argv is a list, one entry per argument; write argv: [python3, node.py]")
        if isinstance(argv, (list, tuple)):
            filled["argv"] = [_as_text(part) for part in argv]
        if isinstance(filled.get("env"), dict):
            filled["env"] = {key: _as_text(part) for key, part in filled["env"].items()}
        if filled.get("builtin") is not None:
            filled.setdefault("ready", "fd")
            filled.setdefault("name", filled["builtin"])
        elif argv and isinstance(argv, (list, tuple)):
            filled.setdefault("name", PurePosixPath(str(argv[0])).name)
        return filled

    @model_validator(mode="after")
    def _one_program(self) -> Self:
        if (self.builtin is None) == (self.argv is None):
            raise ValueError("give the name of a built-in process (udp_mesh, rose) or argv: [program, argument, ...]")
        return self

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"enum": list(BUILTIN_PROCESSES)}, handler(schema)]}


def _as_text(value: object) -> object:
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(value) if isinstance(value, (int, float)) else value


_FILE_WORDS = {"heading_deg": "heading", "speed_mps": "speed", "distance_m": "distance"}
_WALK = ("position", "heading_deg", "waypoints", "speed_mps")
_MOTION_WORDS = {
    "motion": (*_WALK, "follow", "distance_m", "carried_by"),
    "follow": (*_WALK, "carried_by"),
    "carried_by": (*_WALK, "follow", "distance_m"),
}


class Node(StrictModel):
    """A robot, a relay or a base: where it stands or goes and what runs in it. ``position`` is in metres.

    A node stands, goes from waypoint to waypoint (``position`` or else the first one is where it begins), follows
    another one ``distance_m`` behind on its path, is carried by one until a `deploy` event drops it, or goes as its
    ``motion`` file says.
    """

    position: Position = (0.0, 0.0)
    heading_deg: Degrees | None = Field(default=None, alias="heading")
    waypoints: tuple[WaypointWords, ...] = ()
    speed_mps: MetresPerSecond | None = Field(default=None, alias="speed")
    follow: NodeName | None = None
    distance_m: Annotated[float, Quantity(LENGTH, maximum=1e6)] | None = Field(default=None, alias="distance")
    carried_by: NodeName | None = None
    processes: tuple[Process, ...] = ()
    udp_mesh: MeshSettings | None = None
    radio: NodeRadio | None = None
    mesh: MeshWord | None = None
    batman_adv: BatmanSettings | None = None
    flood: FloodSettings | None = None
    babel: BabelSettings | None = None
    wnet: WnetSettings | None = None
    motion: NodeMotion | None = None
    rose: RoseSettings | None = None

    @model_validator(mode="after")
    def _distinct_processes(self) -> Self:
        names = [process.name for process in self.processes]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two processes are called '{twice[0]}'; give one another name:")
        return self

    @model_validator(mode="after")
    def _one_motion(self) -> Self:
        given = self.model_fields_set
        for key in _MOTION_WORDS:
            others = [word for word in _MOTION_WORDS[key] if word in given]
            if key in given and others:
                raise ValueError(
                    f"{_FILE_WORDS.get(others[0], others[0])} means nothing beside {key}; remove one of the two"
                )
        if (self.follow is None) != (self.distance_m is None):
            raise ValueError("follow: NODE and distance: 5m belong together; add the other one")
        legs = self.waypoints if "position" in given else self.waypoints[1:]
        if self.speed_mps is None and any(leg.speed_mps is None for leg in legs):
            raise ValueError("the waypoints have no speed; add speed: 1m/s")
        if self.speed_mps is not None and not self.waypoints:
            raise ValueError("speed is that of a walk; add waypoints or remove it")
        return self

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [handler(schema), {"type": "null"}]}

    @property
    def motion_key(self) -> str | None:
        """The key that makes it move; None if it stands."""
        return next((key for key in ("waypoints", *_MOTION_WORDS) if getattr(self, key)), None)

    def process(self, name: str) -> Process | None:
        """The process of that name, or None."""
        return next((process for process in self.processes if process.name == name), None)
