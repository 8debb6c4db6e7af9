"""The story of one message: every fragment from departure to arrival, and what its latency was made of.

The latency is that of the fragment that arrived last: the message was whole with it. From the publish call to the
receipt its time is divided without gap or overlap, so the parts sum up to the latency. Times are scenario seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from netlab.traces.carriage import Hop
from netlab.traces.causes import INHERENT, Cause
from netlab.traces.model import Stream
from netlab.traces.waiting import Ahead

_LATE_SHARE = 0.2
_LATE_S = 0.001


class Fate(StrEnum):
    """What became of a message."""

    DELIVERED = "delivered"
    REFUSED = "refused"
    """Not taken at the publish call."""
    DROPPED = "dropped"
    """Given up by its sender."""
    NOT_HANDED_OVER = "not_handed_over"
    """The receiver's daemon had it, the subscribing process did not get it."""
    LOST = "lost"
    """On the way, and nothing repeats it."""
    UNDELIVERED = "undelivered"
    """Still on its way, or forgotten, at the end of the capture."""


class Sending(StrEnum):
    """Why a fragment left."""

    FIRST = "first"
    AGAIN = "again"
    """Its sender believed it lost."""
    COPY = "copy"
    """Redundancy."""
    ANEW = "anew"
    """The message was sent from its beginning once more."""


@dataclass(frozen=True, slots=True)
class HopStory:
    """A frame between two interfaces, each as ``node/interface``. ``verdict`` is empty where the medium tells none."""

    sender: str
    receiver: str
    left_s: float
    arrived_s: float | None
    verdict: str
    attempts: int
    rssi_dbm: int | None

    @staticmethod
    def of(hop: Hop, t0_ns: int) -> HopStory:
        """Make it of a hop."""
        verdict = hop.verdict.name.lower() if hop.verdict is not None else ""
        left_s, arrived_s = seconds(hop.left_ns, t0_ns), optional_seconds(hop.arrived_ns, t0_ns)
        ends = "/".join(hop.sender), "/".join(hop.receiver)
        return HopStory(*ends, left_s, arrived_s, verdict, hop.attempts, hop.rssi_dbm)


@dataclass(frozen=True, slots=True)
class Transmission:
    """A fragment that left once. ``arrived_s``: at the destination; ``acked_s``: when its sender heard of that.

    ``counts``: it was for the daemon that delivered the message in the end, under the message's last id.
    ``relays``: the nodes that passed it on.
    """

    packet_number: int
    sending: Sending
    left_s: float
    arrived_s: float | None
    acked_s: float | None
    counts: bool
    hops: tuple[HopStory, ...]
    relays: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FragmentStory:
    """One fragment. ``arrived_s``: first arrival that counts."""

    index: int
    payload_bytes: int
    transmissions: tuple[Transmission, ...]
    arrived_s: float | None


@dataclass(frozen=True, slots=True)
class Part:
    """A part of the latency. ``ahead``: the messages behind which it waited, of parts with cause ``queue``."""

    cause: Cause
    from_s: float
    to_s: float
    words: str
    ahead: tuple[Ahead, ...] = ()

    @property
    def duration_s(self) -> float:
        """How long it took."""
        return self.to_s - self.from_s


@dataclass(frozen=True, slots=True)
class Share:
    """All parts of one cause together. ``ratio`` is of the whole time, 0..1."""

    cause: Cause
    duration_s: float
    ratio: float
    parts: tuple[Part, ...]


@dataclass(frozen=True, slots=True)
class Story:
    """One message of one stream.

    Attributes:
        message_id: In its sender's queue; None if it never came there.
        queued_s: When it did.
        delivered_s: Receipt by the subscribing process.
        ended_s: Where the account ends: the receipt, or when it was given up, or the end of the capture.
        reason: Why it was refused or dropped; empty otherwise.
        critical_index: The fragment whose time the parts tell; None if no fragment left.
        parts: In order, each beginning where the one before ends, from ``published_s`` to ``ended_s``.
        relays: The nodes that passed on the fragment that arrived last.
        typical_s: Median latency of its stream; None if nothing of it was delivered.
        notes: What the capture cannot tell.
    """

    stream: Stream
    seq: int
    size_bytes: int
    message_id: int | None
    published_s: float
    queued_s: float | None
    delivered_s: float | None
    ended_s: float
    fate: Fate
    reason: str
    fragment_count: int
    fragments: tuple[FragmentStory, ...]
    critical_index: int | None
    parts: tuple[Part, ...]
    relays: tuple[str, ...]
    typical_s: float | None
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Name the message for a person."""
        return f"{self.stream.topic} #{self.seq} {self.stream.source}->{self.stream.destination}"

    @property
    def latency_s(self) -> float | None:
        """Publish call to receipt."""
        return None if self.delivered_s is None else self.delivered_s - self.published_s

    @property
    def shares(self) -> tuple[Share, ...]:
        """The parts by cause, the longest first."""
        by_cause: dict[Cause, list[Part]] = {}
        for part in self.parts:
            by_cause.setdefault(part.cause, []).append(part)
        whole_s = self.ended_s - self.published_s
        shares = []
        for cause, parts in by_cause.items():
            total_s = sum(part.duration_s for part in parts)
            shares.append(Share(cause, total_s, total_s / whole_s if whole_s > 0 else 0.0, tuple(parts)))
        return tuple(sorted(shares, key=lambda share: -share.duration_s))

    @property
    def cause(self) -> Cause | None:
        """What took the most time of what a message need not take; None if that is less than a fifth, or 1 ms."""
        avoidable = [share for share in self.shares if share.cause not in INHERENT]
        total_s = sum(share.duration_s for share in avoidable)
        if total_s < max(_LATE_S, _LATE_SHARE * (self.ended_s - self.published_s)):
            return None
        return avoidable[0].cause


def seconds(t_ns: int, t0_ns: int) -> float:
    """Scenario time."""
    return (t_ns - t0_ns) / 1e9


def optional_seconds(t_ns: int | None, t0_ns: int) -> float | None:
    """Scenario time, if there is a time."""
    return None if t_ns is None else seconds(t_ns, t0_ns)
