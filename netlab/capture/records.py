"""What a capture holds, decoded: values only. All ``t_ns`` are CLOCK_REALTIME in nanoseconds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from netlab.capture.schemas import Direction, LogLevel
from netlab.medium.verdicts import Verdict


class Kind(StrEnum):
    """The kinds of records, one per family of topics."""

    PACKET = "packet"
    VERDICT = "verdict"
    EVENT = "event"
    LOG = "log"
    TIMELINE = "timeline"
    LINKS = "links"
    MAP = "map"
    POSES = "poses"
    PUBLISHED = "published"
    RECEIVED = "received"


def kind_of(topic: str) -> Kind:
    """Return the kind of the records on a topic; what is not known is an event."""
    match topic.split("/")[1:]:
        case [_, _, "packets"]:
            return Kind.PACKET
        case ["air", "verdicts"]:
            return Kind.VERDICT
        case ["timeline"]:
            return Kind.TIMELINE
        case ["links"]:
            return Kind.LINKS
        case ["map"]:
            return Kind.MAP
        case ["poses"]:
            return Kind.POSES
        case [_, "log", *_]:
            return Kind.LOG
        case [_, "traffic", "published"]:
            return Kind.PUBLISHED
        case [_, "traffic", "received"]:
            return Kind.RECEIVED
    return Kind.EVENT


class PacketRecord(NamedTuple):
    """One link-layer frame as one interface saw it."""

    t_ns: int
    node: str
    interface: str
    direction: Direction
    linktype: int
    original_length: int
    crc32: int
    frame: bytes


class VerdictRecord(NamedTuple):
    """The medium's decision on one frame for one receiver; ``departs_ns`` is 0 when it was dropped.

    ``attempts`` and ``rssi_dbm`` are an 802.11 radio's: how often it was sent, how strongly the receiver hears the
    sender; 0 and None elsewhere.
    """

    t_ns: int
    sender: tuple[str, str]  # node, interface
    receiver: tuple[str, str]
    verdict: Verdict
    departs_ns: int
    length: int
    crc32: int
    attempts: int = 0
    rssi_dbm: int | None = None


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line of a process's output, stamped when it was read."""

    t_ns: int
    node: str
    process: str
    level: LogLevel
    message: str


@dataclass(frozen=True, slots=True)
class JsonRecord:
    """An event, a traffic record, a step of the timeline, the state of links, the map or the poses.

    ``node`` is empty for the lab's own topics.
    """

    t_ns: int
    kind: Kind
    topic: str
    node: str
    payload: dict[str, object]

    def text(self, key: str) -> str:
        """The value of ``key`` as text, empty if missing."""
        value = self.payload.get(key)
        return "" if value is None else str(value)

    def number(self, key: str) -> int:
        """The value of ``key`` as an integer, 0 if missing or no number."""
        value = self.payload.get(key)
        return int(value) if isinstance(value, int | float) else 0


Record = PacketRecord | VerdictRecord | LogLine | JsonRecord
