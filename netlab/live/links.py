"""The links between nodes as a screen needs them: state and quality of each pair of nodes. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Grade(StrEnum):
    """How good a link is, for colours and words."""

    GOOD = "good"
    FAIR = "fair"
    POOR = "poor"
    DOWN = "down"
    OUT_OF_RANGE = "out of range"


@dataclass(frozen=True, slots=True)
class Direction:
    """One direction of what joins two nodes, as last recorded; ``loss_ratio`` is the mean of its loss model."""

    segment: str
    state: str
    loss_ratio: float = 0.0
    delay_s: float = 0.0
    rate_bps: float | None = None
    rssi_dbm: float | None = None
    snr_db: float | None = None

    @property
    def grade(self) -> Grade:
        """From state, ratio of signal to noise and loss."""
        if self.state == "out_of_range":
            return Grade.OUT_OF_RANGE
        if self.state != "up":
            return Grade.DOWN
        if self.loss_ratio >= 0.15 or (self.snr_db is not None and self.snr_db < 10.0):
            return Grade.POOR
        if self.loss_ratio >= 0.03 or (self.snr_db is not None and self.snr_db < 20.0):
            return Grade.FAIR
        return Grade.GOOD


_ORDER = (Grade.GOOD, Grade.FAIR, Grade.POOR, Grade.DOWN, Grade.OUT_OF_RANGE)


@dataclass(slots=True)
class Link:
    """All that joins two nodes: by (from, to, segment)."""

    a: str
    b: str
    directions: dict[tuple[str, str, str], Direction] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.a}-{self.b}"

    @property
    def grade(self) -> Grade:
        """That of the best way between the two, where the worse direction counts."""
        by_segment: dict[str, list[Grade]] = {}
        for direction in self.directions.values():
            by_segment.setdefault(direction.segment, []).append(direction.grade)
        worst = [max(grades, key=_ORDER.index) for grades in by_segment.values()]
        return min(worst, key=_ORDER.index) if worst else Grade.OUT_OF_RANGE

    def take(self, row: Mapping[str, object]) -> None:
        """Take note of a row of ``/links``."""
        direction = direction_of(row)
        self.directions[str(row["from"]), str(row["to"]), direction.segment] = direction

    @property
    def is_cut(self) -> bool:
        """Whether somebody holds all of it down."""
        return bool(self.directions) and all(d.state in ("outage", "no_carrier") for d in self.directions.values())


def direction_of(row: Mapping[str, object]) -> Direction:
    """A row of ``/links`` as values."""
    words = row.get("impairment")
    known: Mapping[str, object] = words if isinstance(words, Mapping) else {}
    return Direction(
        segment=str(row.get("segment", "")),
        state=str(row.get("state", "")),
        loss_ratio=mean_loss(known.get("loss")),
        delay_s=_number(known.get("delay_s")) or 0.0,
        rate_bps=_number(known.get("rate_bps")),
        rssi_dbm=_number(row.get("rssi_dbm")),
        snr_db=_number(row.get("snr_db")),
    )


def mean_loss(loss: object) -> float:
    """The long-run share of lost frames of a loss model's plain values; 0 where it does not tell."""
    if not isinstance(loss, Mapping):
        return 0.0
    value = {key: _number(number) or 0.0 for key, number in loss.items() if key != "pattern"}
    if "loss_ratio" in value:
        return value["loss_ratio"]
    if "loss_in_bad" in value:  # Gilbert-Elliott: the share of time in the bad state is p / (p + r)
        bad = value["p"] / (value["p"] + value["r"]) if value["p"] + value["r"] else 0.0
        return bad * value["loss_in_bad"] + (1 - bad) * value["loss_in_good"]
    if "every" in value:
        return 1 / value["every"] if value["every"] else 0.0
    pattern = loss.get("pattern")
    return sum(map(bool, pattern)) / len(pattern) if isinstance(pattern, list | tuple) and pattern else 0.0


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None
