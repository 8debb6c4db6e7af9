"""Everything that ended without arriving, by where and why: publish calls, queues, stores, frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

from netlab.capture.records import VerdictRecord
from netlab.medium.verdicts import Verdict
from netlab.traces.daemon_log import Dropped
from netlab.traces.model import Trace

_DROPPED = frozenset(
    {Verdict.LOST, Verdict.QUEUE_FULL, Verdict.OUTAGE, Verdict.OUT_OF_RANGE, Verdict.COLLISION, Verdict.CORRUPTED}
)


class Where(StrEnum):
    """Which part of the way dropped something."""

    PUBLISH = "publish"
    """Messages that were refused at the publish call."""
    QUEUE = "queue"
    """Messages that their sender gave up."""
    STORE = "store"
    """Messages that the sender's store gave up."""
    RECEIVER = "receiver"
    """What a receiver had of a message and forgot."""
    LINK = "link"
    """Frames on one link."""


@dataclass(slots=True)
class Drops:
    """What was dropped at one place for one reason.

    ``priority`` is None and ``topic`` empty where no message is meant. Times are CLOCK_REALTIME, None where only the
    sum is known.
    """

    where: Where
    reason: str
    node: str
    peer: str
    topic: str = ""
    priority: int | None = None
    count: int = 0
    size_bytes: int = 0
    first_ns: int | None = None
    last_ns: int | None = None

    def add(self, t_ns: int, size_bytes: int) -> None:
        """Count one more."""
        self.count, self.size_bytes = self.count + 1, self.size_bytes + size_bytes
        self.first_ns = t_ns if self.first_ns is None else min(self.first_ns, t_ns)
        self.last_ns = t_ns if self.last_ns is None else max(self.last_ns, t_ns)


def drops(
    trace: Trace, verdicts: Iterable[VerdictRecord], *, chosen: Callable[[int], bool] = lambda _t_ns: True
) -> list[Drops]:
    """Sum up what was dropped, by place and reason; the most frequent first within each place.

    Args:
        trace: ``links`` count where the medium tells no verdicts.
        verdicts: All of the capture, or of the time that is asked for.
        chosen: Whether a moment is asked for.
    """
    found: dict[tuple[Where, str, str, str, str], Drops] = {}

    def at(where: Where, reason: str, node: str, peer: str, topic: str = "", priority: int | None = None) -> Drops:
        new = Drops(where, reason, node, peer, topic, priority)
        return found.setdefault((where, reason, node, peer, topic), new)

    for stream in trace.streams:
        for entry in trace.published.get(stream.index, []):
            if not entry.accepted and chosen(entry.t_ns):
                of = at(
                    Where.PUBLISH, entry.reason or "", stream.source, stream.destination, stream.topic, stream.priority
                )
                of.add(entry.t_ns, entry.size_bytes)
    for drop in trace.daemons.drops:
        if chosen(drop.t_ns):
            at(_where(drop), drop.reason, drop.node, drop.peer, drop.topic, drop.priority).add(
                drop.t_ns, drop.size_bytes
            )
    for verdict in verdicts:
        if verdict.verdict in _DROPPED and chosen(verdict.t_ns):
            reason, ends = verdict.verdict.name.lower(), ("/".join(verdict.sender), "/".join(verdict.receiver))
            at(Where.LINK, reason, *ends).add(verdict.t_ns, verdict.length)
    _add_counted(trace, at)
    order = list(Where)
    return sorted(found.values(), key=lambda entry: (order.index(entry.where), -entry.count))


def _where(drop: Dropped) -> Where:
    if drop.is_partial:
        return Where.RECEIVER
    return Where.STORE if drop.is_stored else Where.QUEUE


def _add_counted(trace: Trace, at: Callable[[Where, str, str, str], Drops]) -> None:
    """Frames of engines without verdicts, whose number is all that is known."""
    for (sender, receiver), counts in trace.links.items():
        told = {verdict.name.lower(): count for verdict, count in counts.verdicts.items() if verdict in _DROPPED}
        if counts.lost_or_queue_full:
            told["lost or queue_full"] = counts.lost_or_queue_full
        for reason, count in told.items():
            entry = at(Where.LINK, reason, "/".join(sender), "/".join(receiver))
            if count and entry.count == 0:
                entry.count = count
