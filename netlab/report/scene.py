"""What a report needs of a capture beyond the trace: the map, the poses, the states of links, each radio decision."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from netlab.capture.reader import Capture, OnRead
from netlab.capture.records import JsonRecord, Kind, Record, VerdictRecord
from netlab.medium.verdicts import Verdict

_KINDS = frozenset({Kind.VERDICT, Kind.MAP, Kind.POSES, Kind.LINKS})
_NS_PER_S = 1e9

Place = tuple[float, float]


@dataclass(slots=True)
class Scene:
    """Where everything was and how links fared.

    Attributes:
        metadata: Of the run.
        losses: What the recorder had to leave out, by topic.
        tunnels: Centre lines in metres, by name.
        paths: (scenario time, x, y) of every node that had a place, in the order of time.
        success: By "sender > receiver": (scenario time, share) of the frames in range that arrived, per second.
        rssi_dbm: Alike, mean signal strength at the receiver, where the radio tells.
        down_s: By (sender, receiver): when no link of theirs was up, as (from, to) in scenario time.
    """

    metadata: dict[str, str] = field(default_factory=dict)
    losses: dict[str, int] = field(default_factory=dict)
    tunnels: dict[str, list[Place]] = field(default_factory=dict)
    paths: dict[str, list[tuple[float, float, float]]] = field(default_factory=dict)
    success: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    rssi_dbm: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    down_s: dict[tuple[str, str], list[tuple[float, float]]] = field(default_factory=dict)


def load_scene(path: Path, on_read: OnRead = lambda done, total: None) -> Scene:
    """Read what the plots of places and links need; what a capture does not hold stays empty.

    ``on_read`` hears how far the reading has come.

    Raises:
        CaptureError: The file is no capture.
    """
    with Capture.open(path, on_read) as capture:
        loader = _Loader(capture.t0_ns)
        loader.scene.metadata = capture.metadata
        loader.scene.losses = {topic: count for topic, count in (capture.losses or {}).items() if count}
        for record in capture.records(_KINDS):
            loader.take(record, (record.t_ns - capture.t0_ns) / _NS_PER_S)
    return loader.finish()


class _Loader:
    def __init__(self, t0_ns: int) -> None:
        self._t0_ns = t0_ns
        self.scene = Scene()
        self._success, self._rssi_dbm, self._states = _Means(), _Means(), _States()

    def take(self, record: Record, at_s: float) -> None:
        if isinstance(record, VerdictRecord):
            self._verdict(record, at_s)
        elif isinstance(record, JsonRecord) and record.kind is Kind.POSES:
            _poses(self.scene, record.payload, at_s, self._t0_ns)
        elif isinstance(record, JsonRecord) and record.kind is Kind.LINKS:
            self._states.add(record, at_s)
        elif isinstance(record, JsonRecord):
            _map(self.scene, record.payload)

    def finish(self) -> Scene:
        self.scene.success, self.scene.rssi_dbm = self._success.series(), self._rssi_dbm.series()
        self.scene.down_s = self._states.down_s()
        return self.scene

    def _verdict(self, record: VerdictRecord, at_s: float) -> None:
        sender, receiver = record.sender[0], record.receiver[0]
        if record.verdict is Verdict.OUT_OF_RANGE or sender == receiver or not self._take_part(sender, receiver):
            return
        pair = f"{sender} > {receiver}"
        self._success.add(pair, at_s, float(record.departs_ns > 0))
        if record.rssi_dbm is not None and record.verdict is not Verdict.OUTAGE:
            self._rssi_dbm.add(pair, at_s, record.rssi_dbm)

    def _take_part(self, *nodes: str) -> bool:
        """Whether none of the nodes is still carried, as far as the capture tells places at all."""
        return not self.scene.paths or all(node in self.scene.paths for node in nodes)


class _Means:
    """Means per second: an hour of mission has millions of frames."""

    def __init__(self) -> None:
        self._sums: dict[str, dict[int, tuple[int, float]]] = {}

    def add(self, name: str, at_s: float, value: float) -> None:
        seconds = self._sums.setdefault(name, {})
        count, total = seconds.get(math.floor(at_s), (0, 0.0))
        seconds[math.floor(at_s)] = count + 1, total + value

    def series(self) -> dict[str, list[tuple[float, float]]]:
        return {
            name: [(second + 0.5, total / count) for second, (count, total) in sorted(seconds.items())]
            for name, seconds in sorted(self._sums.items())
        }


class _States:
    """When the links of a pair of nodes were up; one that never was up says nothing."""

    def __init__(self) -> None:
        self._is_up: dict[tuple[str, str], dict[str, bool]] = {}
        self._since_s: dict[tuple[str, str], float] = {}
        self._spans: dict[tuple[str, str], list[tuple[float, float]]] = {}

    def add(self, record: JsonRecord, at_s: float) -> None:
        pair = (record.text("from"), record.text("to"))
        self._is_up.setdefault(pair, {})[record.text("segment")] = record.text("state") == "up"
        if any(self._is_up[pair].values()):
            if pair in self._since_s:
                self._spans.setdefault(pair, []).append((self._since_s.pop(pair), at_s))
        else:
            self._since_s.setdefault(pair, at_s)

    def down_s(self) -> dict[tuple[str, str], list[tuple[float, float]]]:
        for pair, since_s in self._since_s.items():
            if pair in self._spans or since_s > 0.0:
                self._spans.setdefault(pair, []).append((since_s, math.inf))
        return self._spans


def _poses(scene: Scene, payload: Mapping[str, object], at_s: float, t0_ns: int) -> None:
    nodes, poses, active = (payload.get(key) for key in ("nodes", "poses", "active"))
    if not isinstance(nodes, list) or not isinstance(poses, list):
        return
    taking_part = active if isinstance(active, list) else [True] * len(nodes)
    stamp_ns = payload.get("stamp_ns")
    when_s = max((stamp_ns - t0_ns) / _NS_PER_S, 0.0) if isinstance(stamp_ns, int) and stamp_ns else at_s
    for node, pose, is_active in zip(nodes, poses, taking_part, strict=False):
        place = _place(pose.get("position") if isinstance(pose, dict) else None)
        if place is not None and is_active:
            scene.paths.setdefault(str(node), []).append((when_s, *place))


def _place(position: object) -> Place | None:
    if not isinstance(position, dict):
        return None
    x, y = position.get("x"), position.get("y")
    return (float(x), float(y)) if isinstance(x, int | float) and isinstance(y, int | float) else None


def _map(scene: Scene, payload: Mapping[str, object]) -> None:
    tunnels = payload.get("tunnels")
    for number, tunnel in enumerate(tunnels if isinstance(tunnels, list) else []):
        if isinstance(tunnel, dict) and isinstance(tunnel.get("path"), list):
            places = list(_corners(tunnel["path"]))
            if len(places) > 1:
                scene.tunnels[str(tunnel.get("name", number))] = places


def _corners(path: Iterable[object]) -> Iterable[Place]:
    for point in path:
        if isinstance(point, list) and len(point) >= 2 and all(isinstance(part, int | float) for part in point):
            yield float(point[0]), float(point[1])
