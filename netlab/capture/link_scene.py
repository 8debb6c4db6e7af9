"""The links as Foxglove draws them: lines between nodes, coloured by quality. Fed by ``/links`` and ``/poses``. Pure.

One entity per pair of nodes and segment, with the worse of its two directions: from blue and thick (good) over yellow
to red-orange and thin (bad), told apart by colour-blind people too; dashed while somebody holds it down. Pairs out of
range are not drawn. Every message is a whole scene, so that a player that jumps into a file is never wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from netlab.capture.foxglove import Place, colour, delete, new_entity, places, points

_GOOD, _FAIR, _BAD = (0.0, 0.45, 0.7), (0.94, 0.89, 0.26), (0.84, 0.37, 0.0)
_LIMIT_SNR_DB, _GOOD_SNR_DB = 5.0, 30.0
_THICK_PX, _THIN_PX = 4.0, 1.5
_DASHES = 8
_HELD = ("outage", "no_carrier")


@dataclass(frozen=True, slots=True)
class _Direction:
    state: str
    quality: float
    snr_db: float | None


class LinkScene:
    """The scene as it is now."""

    def __init__(self) -> None:
        self._places: dict[str, Place] = {}
        self._directions: dict[tuple[str, str, str], _Direction] = {}  # by segment, sender and receiver
        self._drawn: set[str] = set()
        self._is_new = False

    def take_poses(self, payload: Mapping[str, object]) -> None:
        """Nodes are elsewhere now; ``payload`` is a message of ``/poses``."""
        found = places(payload)
        self._is_new |= found != self._places
        self._places = found

    def take_link(self, row: Mapping[str, object]) -> None:
        """A directed pair has another state; ``row`` is a message of ``/links``."""
        key = (str(row.get("segment")), str(row.get("from")), str(row.get("to")))
        snr_db = row.get("snr_db")
        told = float(snr_db) if isinstance(snr_db, int | float) else None
        direction = _Direction(str(row.get("state")), quality(row), told)
        self._is_new |= self._directions.get(key) != direction
        self._directions[key] = direction

    def message(self, t_ns: int) -> bytes | None:
        """Return the scene as a ``foxglove.SceneUpdate``; None if nothing changed since the last one."""
        if not self._is_new or not self._places:
            return None
        self._is_new = False
        scene, drawn = SceneUpdate(), set()
        for segment, one, two in sorted({(key[0], *sorted(key[1:])) for key in self._directions}):
            both = [self._directions.get((segment, *ends)) for ends in ((one, two), (two, one))]
            shown = [direction for direction in both if direction is not None and direction.state != "out_of_range"]
            if one in self._places and two in self._places and one != two and shown:
                name = f"link/{one}-{two}/{segment}"
                drawn.add(name)
                self._draw(scene, name, (one, two), min(shown, key=_rank), t_ns)
        delete(scene, self._drawn - drawn, t_ns)
        self._drawn = drawn
        return bytes(scene.SerializeToString())

    def _draw(self, scene: SceneUpdate, name: str, ends: tuple[str, str], worse: _Direction, t_ns: int) -> None:
        entity = new_entity(scene, name, t_ns)
        entity.metadata.add(key="state", value=worse.state)
        entity.metadata.add(key="quality", value=f"{worse.quality:.2f}")
        if worse.snr_db is not None:
            entity.metadata.add(key="snr_db", value=f"{worse.snr_db:.1f}")
        line = entity.lines.add(type=LinePrimitive.LINE_LIST, scale_invariant=True)
        line.pose.orientation.w = 1.0
        line.thickness = _THIN_PX + (_THICK_PX - _THIN_PX) * worse.quality
        line.color.CopyFrom(colour((*blend(worse.quality), 1.0)))
        start, end = (self._places[node] for node in ends)
        line.points.extend(points(_dashes(start, end) if worse.state in _HELD else (start, end)))


def quality(row: Mapping[str, object]) -> float:
    """How good a directed pair is, 0..1: by its signal to noise ratio where it is a radio's, else by its loss."""
    if row.get("state") != "up":
        return 0.0
    snr_db = row.get("snr_db")
    if isinstance(snr_db, int | float):
        return min(max((snr_db - _LIMIT_SNR_DB) / (_GOOD_SNR_DB - _LIMIT_SNR_DB), 0.0), 1.0)
    impairment = row.get("impairment")
    loss = impairment.get("loss") if isinstance(impairment, dict) else None
    return 1.0 - min(2 * _mean_loss(loss), 1.0) if isinstance(loss, dict) else 1.0  # half of all lost is as bad as none


def _mean_loss(loss: Mapping[str, object]) -> float:
    """Mean loss ratio of a random or Gilbert-Elliott model; a quarter of the others, whose mean tells little."""
    known = {key: float(value) for key, value in loss.items() if isinstance(value, int | float)}
    if "loss_ratio" in known:
        return known["loss_ratio"]
    if {"p", "r", "loss_in_bad", "loss_in_good"} <= known.keys() and known["p"] + known["r"] > 0:
        bad = known["p"] / (known["p"] + known["r"])
        return bad * known["loss_in_bad"] + (1 - bad) * known["loss_in_good"]
    return 0.25


def blend(value: float) -> tuple[float, float, float]:
    """The colour of a quality: bad, fair and good at 0, 0.5 and 1, and what lies between."""
    below, above, part = (_BAD, _FAIR, 2 * value) if value < 0.5 else (_FAIR, _GOOD, 2 * value - 1)
    red, green, blue = (a + (b - a) * part for a, b in zip(below, above, strict=True))
    return red, green, blue


def _rank(direction: _Direction) -> tuple[bool, float]:
    return direction.state not in _HELD, direction.quality


def _dashes(start: Place, end: Place) -> Sequence[Place]:
    """Ends of dashes along a line: pairs of places."""
    parts = [step / (2 * _DASHES - 1) for step in range(2 * _DASHES)]
    return [(*(a + (b - a) * part for a, b in zip(start, end, strict=True)),) for part in parts]  # type: ignore[misc]
