"""Divides the time of one message into parts with causes: the reasoning behind :class:`netlab.traces.story.Story`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

from netlab.medium.verdicts import Verdict
from netlab.traces.absences import absences
from netlab.traces.carriage import ARRIVED, Carriage, carriage
from netlab.traces.causes import Cause, Stretch, merged, painted
from netlab.traces.daemon_log import ACKED, QueuedMessage, StoredMessage
from netlab.traces.evidence import Departure, Evidence
from netlab.traces.model import Published, Stream, Trace
from netlab.traces.transit import frame_ns, transit
from netlab.traces.waiting import Sender

_STAMP_SLACK_NS = 1_000_000
_MISSING = {
    Verdict.OUTAGE: Cause.OUTAGE,
    Verdict.OUT_OF_RANGE: Cause.OUT_OF_RANGE,
    Verdict.QUEUE_FULL: Cause.QUEUE_FULL,
}
_HOW = {
    Verdict.LOST: "was lost",
    Verdict.COLLISION: "was drowned by another transmission",
    Verdict.CORRUPTED: "was corrupted",
    Verdict.OUTAGE: "was lost in an outage",
    Verdict.OUT_OF_RANGE: "was out of range",
    Verdict.QUEUE_FULL: "found the queue full",
}


@dataclass(frozen=True, slots=True)
class Attempt:
    """A fragment that left once, and its way. ``counts`` as in :class:`netlab.traces.story.Transmission`."""

    departure: Departure
    carried: Carriage
    counts: bool
    acked_ns: int | None

    @property
    def arrived_ns(self) -> int | None:
        """Arrival at the destination, if it counts; where nobody saw it, when its sender heard of it."""
        if not self.counts:
            return None
        return self.acked_ns if self.carried.arrived_ns is None else self.carried.arrived_ns


class Account:
    """All that is known of one message from its publication to its end, fragment by fragment.

    Args:
        message: What it was in its sender's queue.
        end_ns: Receipt by the application, or when it was given up, or the end of the capture.

    Attributes:
        attempts: By fragment, in the order of time.
    """

    def __init__(
        self,
        trace: Trace,
        evidence: Evidence,
        stream: Stream,
        published: Published,
        message: QueuedMessage,
        *,
        end_ns: int,
        is_delivered: bool,
    ) -> None:
        self._trace, self._evidence, self._stream = trace, evidence, stream
        self._published, self._message, self._end_ns = published, message, end_ns
        self._is_delivered = is_delivered
        meetings = trace.daemons.meetings.get((stream.source, stream.destination), [])
        tags = {meeting.epoch & 0xFFFFFFFF for meeting in meetings}
        self.lane = Sender(trace, evidence, message, tags, self._frame_ns)
        self._away = absences(trace, stream.source, stream.destination)
        self.attempts: dict[int, list[Attempt]] = {}
        self._follow(tags | {0})

    def _follow(self, tags: set[int]) -> None:
        message = self._message
        mine = [
            departure
            for departure in self._evidence.departures
            if departure.message_id in message.ids_on_wire
            and departure.destination_tag in tags
            and message.queued_ns - _STAMP_SLACK_NS <= departure.t_ns <= self._end_ns
        ]
        last_tag = mine[-1].destination_tag if mine else 0
        for departure in mine:
            carried = carriage(
                self._trace, self._evidence, departure.packet, self._stream.destination, left_ns=departure.t_ns
            )
            counts = (departure.destination_tag, departure.message_id) == (last_tag, message.last_id_on_wire)
            tag, t_ns = departure.destination_tag, departure.t_ns
            acked_ns = self._evidence.first_ack(departure.packet, after_ns=t_ns, from_tag=tag) if tag else None
            self.attempts.setdefault(departure.index, []).append(Attempt(departure, carried, counts, acked_ns))

    def _frame_ns(self, departure: Departure) -> int:
        return frame_ns(self._trace, self._evidence, departure.packet, self._quickest_ns)

    @cached_property
    def _quickest_ns(self) -> int:
        """The least time that any fragment of it took to its destination."""
        attempts = (attempt for tries in self.attempts.values() for attempt in tries)
        times = (a.carried.arrived_ns - a.departure.t_ns for a in attempts if a.carried.arrived_ns is not None)
        return min(times, default=0)

    def arrived_ns(self, index: int) -> int | None:
        """First arrival of a fragment that counts."""
        times = (attempt.arrived_ns for attempt in self.attempts.get(index, []))
        return min((t for t in times if t is not None and t <= self._end_ns), default=None)

    def critical(self) -> int | None:
        """The fragment that arrived last, or the first that did not arrive; None if no fragment left."""
        if not self.attempts:
            return None
        arrivals = {index: self.arrived_ns(index) for index in range(self._message.fragment_count)}
        missing = [index for index, t_ns in arrivals.items() if t_ns is None]
        seen = {index: t_ns for index, t_ns in arrivals.items() if t_ns is not None}
        if missing and not (self._is_delivered and seen):  # of a delivered one, the capture has missed something
            return missing[0]
        return max(seen, key=lambda index: (seen[index], index))

    def bringing(self, index: int | None) -> Attempt | None:
        """The attempt with which a fragment arrived first."""
        arrived_ns = None if index is None else self.arrived_ns(index)
        if index is None or arrived_ns is None:
            return None
        return next(attempt for attempt in self.attempts[index] if attempt.arrived_ns == arrived_ns)

    def stretches(self) -> list[Stretch]:
        """The whole time from the publish call to the end, divided by cause."""
        index = self.critical()
        tries = self.attempts.get(index, []) if index is not None else []
        brought = self.bringing(index)
        waits = [*self._before_queue(), *self._held(tries[0].departure.t_ns if tries else self._end_ns)]
        for attempt, following in pairwise([*tries, None]):
            if attempt is not None and attempt is not brought:
                waits.append(self._failed(attempt, following))
            else:
                break
        waits = painted(waits, self._away)
        return merged(_clipped([*waits, *self._arrival(brought)], self._published.t_ns, self._end_ns))

    def _arrival(self, brought: Attempt | None) -> list[Stretch]:
        if brought is None or brought.arrived_ns is None:
            return []
        at_ns = brought.carried.arrived_ns
        unseen = [Stretch(brought.departure.t_ns, brought.arrived_ns, Cause.UNEXPLAINED, "nobody saw it arrive")]
        way = (
            unseen
            if at_ns is None
            else transit(self._trace, self._evidence, brought.carried, brought.departure, self.lane.named)
        )
        inside = Stretch(brought.arrived_ns, self._end_ns, Cause.REASSEMBLY, self._handing_over(brought.arrived_ns))
        died = [stretch for stretch in self._away if stretch.cause is Cause.RESTART]
        return [*way, *painted([inside], died)]

    def _before_queue(self) -> list[Stretch]:
        message, start_ns = self._message, self._published.t_ns
        source = self._stream.source
        if message.stored is None:
            return [Stretch(start_ns, message.queued_ns, Cause.HANDOVER, f"to the daemon of {source}")]
        return in_store(source, start_ns, message.stored, message.queued_ns)

    def _held(self, left_ns: int) -> list[Stretch]:
        message, start_ns = self._message, self._message.queued_ns
        if not message.held:
            return self._wait(start_ns, left_ns)
        end_ns = min(message.released_ns or left_ns, left_ns)
        until = "until" if message.released_ns is not None else "to its end at"
        words = f"the rate limit of {message.topic} held it back {until} {self._trace.seconds(end_ns):.3f} s"
        return [Stretch(start_ns, end_ns, Cause.RATE_LIMIT, words), *self._wait(end_ns, left_ns)]

    def _wait(self, from_ns: int, left_ns: int) -> list[Stretch]:
        if not self.attempts and (self._is_delivered or self._message.outcome == ACKED):
            return [Stretch(from_ns, left_ns, Cause.UNEXPLAINED, "no packet of it can be read")]
        return self.lane.wait(from_ns, left_ns)

    def _failed(self, attempt: Attempt, following: Attempt | None) -> Stretch:
        departure = attempt.departure
        end_ns = self._end_ns if following is None else following.departure.t_ns
        which = f"fragment {departure.index + 1}/{departure.count} left at {self._trace.seconds(departure.t_ns):.3f} s"
        after = "" if following is None else f"; it left again at {self._trace.seconds(end_ns):.3f} s"
        cause, how = self._failure(attempt)
        return Stretch(departure.t_ns, end_ns, cause, f"{which} {how}{after}")

    def _failure(self, attempt: Attempt) -> tuple[Cause, str]:
        destination, t_ns = self._stream.destination, attempt.departure.t_ns
        if not attempt.counts:
            return Cause.RESTART, f"for a daemon of {destination} that has forgotten it"
        if attempt.carried.arrived_ns is not None:  # after the account's end
            return Cause.UNEXPLAINED, "and had not arrived by then"
        hop = attempt.carried.hops[-1] if attempt.carried.hops else None
        cause, how = Cause.LOSS, "did not arrive"
        if hop is not None and hop.verdict in ARRIVED:
            return Cause.UNEXPLAINED, f"and nobody saw it arrive at {'/'.join(hop.receiver)}"
        if hop is not None and hop.verdict is not None:
            cause, how = _MISSING.get(hop.verdict, Cause.LOSS), _HOW.get(hop.verdict, how)
        if any(stretch.from_ns <= t_ns < stretch.to_ns for stretch in self._away):
            cause = Cause.RECONNECT  # what is left of this wait when the path is back: its sender has yet to try again
        where = f" on {'/'.join(hop.sender)} > {'/'.join(hop.receiver)}" if hop is not None else ""
        return cause, f"and {how}{where}"

    def _handing_over(self, arrived_ns: int) -> str:
        destination = self._stream.destination
        whole_ns = self._trace.daemons.delivered_at(
            destination, self._stream.source, self._message.last_id_on_wire, from_ns=arrived_ns - 1_000_000
        )
        if whole_ns is None or whole_ns > self._end_ns:
            return f"inside {destination}"
        return f"inside {destination}: put together at {self._trace.seconds(whole_ns):.6f} s, then to the application"


def in_store(source: str, published_ns: int, stored: StoredMessage, end_ns: int) -> list[Stretch]:
    """The time of a message in its sender's store, before the transport had it."""
    return [
        Stretch(published_ns, stored.stored_ns, Cause.HANDOVER, f"into the store of {source}"),
        Stretch(stored.stored_ns, end_ns, Cause.QUEUE, f"in the store of {source}"),
    ]


def _clipped(stretches: list[Stretch], start_ns: int, end_ns: int) -> list[Stretch]:
    """Make the stretches cover a time exactly: clock stamps of different processes may cross by microseconds."""
    out: list[Stretch] = []
    at_ns = start_ns
    for stretch in stretches:
        until_ns = min(max(stretch.to_ns, at_ns), end_ns)
        if stretch.from_ns > at_ns:
            out.append(Stretch(at_ns, min(stretch.from_ns, end_ns), Cause.UNEXPLAINED))
            at_ns = min(stretch.from_ns, end_ns)
        out.append(replace(stretch, from_ns=at_ns, to_ns=until_ns))
        at_ns = until_ns
    return [*out, Stretch(at_ns, end_ns, Cause.UNEXPLAINED)]
