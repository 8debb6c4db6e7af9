"""What a report needs of a capture beyond the trace: the map, the poses, and each radio decision."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind, VerdictRecord
from netlab.medium.verdicts import Verdict

_KINDS = frozenset({Kind.VERDICT, Kind.MAP, Kind.POSES})
_NS_PER_S = 1e9

Place = tuple[float, float]


@dataclass(slots=True)
class Scene:
    """Where everything was and how links fared.

    Attributes:
        metadata: Of the run.
        tunnels: Centre lines in metres, by name.
        paths: (scenario time, x, y) of every node that had a place, in the order of time.
        success: By "sender > receiver": (scenario time, share) of the frames in range that arrived, per second.
        rssi_dbm: Alike, mean signal strength at the receiver, where the radio tells.
    """

    metadata: dict[str, str] = field(default_factory=dict)
    tunnels: dict[str, list[Place]] = field(default_factory=dict)
    paths: dict[str, list[tuple[float, float, float]]] = field(default_factory=dict)
    success: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    rssi_dbm: dict[str, list[tuple[float, float]]] = field(default_factory=dict)


def load_scene(path: Path) -> Scene:
    """Read what the plots of places and links need; what a capture does not hold stays empty.

    Raises:
        CaptureError: The file is no capture.
    """
    scene, success, rssi_dbm = Scene(), _Means(), _Means()
    with Capture.open(path) as capture:
        scene.metadata = capture.metadata
        for record in capture.records(_KINDS):
            at_s = (record.t_ns - capture.t0_ns) / _NS_PER_S
            if isinstance(record, VerdictRecord) and record.verdict is not Verdict.OUT_OF_RANGE:
                pair = f"{record.sender[0]} > {record.receiver[0]}"
                success.add(pair, at_s, float(record.departs_ns > 0))
                if record.rssi_dbm is not None and record.verdict is not Verdict.OUTAGE:
                    rssi_dbm.add(pair, at_s, record.rssi_dbm)
            elif isinstance(record, JsonRecord) and record.kind is Kind.POSES:
                _poses(scene, record.payload, at_s)
            elif isinstance(record, JsonRecord):
                _map(scene, record.payload)
    scene.success, scene.rssi_dbm = success.series(), rssi_dbm.series()
    return scene


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


def _poses(scene: Scene, payload: Mapping[str, object], at_s: float) -> None:
    nodes, poses, active = (payload.get(key) for key in ("nodes", "poses", "active"))
    if not isinstance(nodes, list) or not isinstance(poses, list):
        return
    taking_part = active if isinstance(active, list) else [True] * len(nodes)
    told = payload.get("t_s")
    when_s = float(told) if isinstance(told, int | float) else at_s
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
