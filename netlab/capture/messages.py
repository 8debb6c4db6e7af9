"""What the supervisor and the recorder say to each other over their :class:`netlab.ipc.Channel`. Values only."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


class FeedKind(StrEnum):
    """How the bytes of a feed are cut into messages."""

    EVENTS = "events"  # JSON objects, one per line
    VERDICTS = "verdicts"  # packed VERDICT_RECORDs
    LOG = "log"  # text lines


@dataclass(frozen=True, slots=True)
class Open:
    """Create the file. ``ports[i]`` is (node, interface) of the medium's port i; ``nodes`` scales the rings."""

    path: str
    metadata: dict[str, str]
    attachments: dict[str, bytes]
    nodes: int


@dataclass(frozen=True, slots=True)
class AddInterfaces:
    """Sniff a node; comes with the descriptor of its network namespace."""

    node: str
    interfaces: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class AddFeed:
    """Read a feed; comes with the descriptor to read from."""

    kind: FeedKind
    topic: str
    node: str
    process: str


@dataclass(frozen=True, slots=True)
class Message:
    """Record one JSON object on a topic of the lab itself (timeline, links)."""

    topic: str
    payload: dict[str, object]
    t_ns: int


@dataclass(frozen=True, slots=True)
class SetMetadata:
    """Values of the record ``netlab.run`` that are known only now: scenario time zero, a longer duration."""

    values: dict[str, str]


@dataclass(frozen=True, slots=True)
class Subscribe:
    """Somebody looks on; comes with the socket. ``packets``: with packets and verdicts too."""

    packets: bool


@dataclass(frozen=True, slots=True)
class OpenFile:
    """Finish the present file, if any, and begin another one; answer with ``Done``."""

    path: str


@dataclass(frozen=True, slots=True)
class CloseFile:
    """Finish the present file; those who look on go on. Answer with ``Done``."""


@dataclass(frozen=True, slots=True)
class Sync:
    """Answer with ``Done`` when everything before this has taken effect."""


@dataclass(frozen=True, slots=True)
class Close:
    """Record what is still on its way, finish the file, answer with ``RecorderStats``, end."""


@dataclass(frozen=True, slots=True)
class Done:
    """Answer to ``Open`` and ``Sync``: what went wrong since the last answer, empty if nothing."""

    errors: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Notice:
    """Unasked: something that a person should know now (disk full, kernel dropped packets)."""

    text: str


@dataclass(frozen=True, slots=True)
class RecorderStats:
    """What became of a recording.

    ``kernel_drops`` counts packets per node that the ring had no room for. ``feed_lines_dropped`` counts lines of feeds
    that were not recorded because they were no JSON object or too long. ``messages_lost`` counts everything that could
    not be written after a write error. ``failure`` is None or says why the recorder ended early.
    """

    messages: int = 0
    packets: int = 0
    kernel_drops: dict[str, int] = field(default_factory=dict)
    write_errors: tuple[str, ...] = ()
    messages_lost: int = 0
    feed_lines_dropped: int = 0
    failure: str | None = None
