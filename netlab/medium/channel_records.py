"""What a shared channel keeps of a frame, and what it tells about it. Values only."""

from __future__ import annotations

from dataclasses import dataclass

from netlab.medium.channel_receptions import Signal
from netlab.medium.phy import Rate
from netlab.medium.verdicts import Verdict


@dataclass(slots=True, eq=False)
class Queued:
    """A frame in a station, and what has become of it so far.

    ``receiver`` None: whoever hears it, at ``rate``, or where that is None at the lowest basic one.
    """

    sender: int
    receiver: int | None
    frame: bytes
    offered_s: float
    tag: int
    size_bytes: int  # on the air
    rate: Rate | None = None
    attempts: int = 0
    delivered: bool = False


#: (receiver, verdict)
Fate = tuple[int, Verdict]


@dataclass(frozen=True, slots=True)
class Decided:
    """What became of a frame at ``at_s``: one fate for each receiver that it concerns, ports everywhere.

    ``attempts`` were made until then. ``tag`` is the caller's; ``offered_s`` when the frame came.
    """

    at_s: float
    sender: int
    frame: bytes
    offered_s: float
    tag: int
    fates: list[Fate]
    attempts: int
    rate: Rate


@dataclass(slots=True)
class ChannelStats:
    """Counters since the start: ``airtime_s`` sums up over stations, acknowledgements and collisions included."""

    attempts: int = 0
    acknowledged: int = 0
    given_up: int = 0
    queue_full: int = 0
    airtime_s: float = 0.0


@dataclass(slots=True, eq=False)
class Exchange:
    """A frame on the air; ``ack`` once its receiver answers, which keeps ``late_hearers`` busy too."""

    queued: Queued
    signal: Signal
    hearers: tuple[int, ...]
    verdict: Verdict = Verdict.LOST
    ack: Signal | None = None
    late_hearers: tuple[int, ...] = ()
