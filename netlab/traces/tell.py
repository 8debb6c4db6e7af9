"""Tells the story of one message: finds its packets in the capture, and puts the account into words."""

from __future__ import annotations

from netlab.capture.reader import Capture
from netlab.traces.absences import absences
from netlab.traces.account import Account, Attempt, in_store
from netlab.traces.causes import Cause, Stretch, merged, painted
from netlab.traces.daemon_log import ACKED, QueuedMessage
from netlab.traces.evidence import Evidence, gather
from netlab.traces.identity import by_order, queued_message, stored_by_order
from netlab.traces.model import EVERYBODY, Delivery, Published, Stream, Trace
from netlab.traces.story import (
    Fate,
    FragmentStory,
    HopStory,
    Part,
    Sending,
    Story,
    Transmission,
    optional_seconds,
)
from netlab.traces.streams import latencies_s, percentile
from netlab.traces.waiting import behind

_BEFORE_NS = 2_000_000_000  # what may still have been in the link's queue
_AFTER_NS = 1_000_000_000  # for its acknowledgements


def tell(capture: Capture, trace: Trace, stream: Stream, published: Published) -> Story:
    """Tell the story of one publication to one destination.

    Args:
        capture: Of which the trace is; the packets around the message are read from it.
        trace: With or without packets.
        stream: Of the trace.
        published: Of the stream.
    """
    delivery = first_delivery(trace, stream, published)
    guess = by_order(trace, stream).get(published.seq)
    end_ns = _end_ns(capture, delivery, guess)
    evidence = gather(
        capture, stream.source, start_ns=published.t_ns - _BEFORE_NS, end_ns=end_ns + _AFTER_NS if end_ns else 1 << 62
    )
    return story(trace, evidence, stream, published, capture_end_ns=capture.end_ns)


def first_delivery(trace: Trace, stream: Stream, published: Published) -> Delivery | None:
    """The first receipt of a publication."""
    return next((entry for entry in trace.delivered.get(stream.index, []) if entry.seq == published.seq), None)


def story(trace: Trace, evidence: Evidence, stream: Stream, published: Published, *, capture_end_ns: int) -> Story:
    """Tell the story from evidence that covers it. Pure."""
    delivery = first_delivery(trace, stream, published)
    message = queued_message(trace, stream, published, evidence.departures)
    end_ns = _end_ns_of(delivery, message) or max(capture_end_ns, published.t_ns)
    if not published.accepted or message is None:
        return _short(trace, stream, published, delivery, end_ns)
    account = Account(trace, evidence, stream, published, message, end_ns=end_ns, is_delivered=delivery is not None)
    brought = account.bringing(account.critical())
    fate, reason = _fate(account, message, delivery)
    return Story(
        stream,
        published.seq,
        published.size_bytes,
        message.message_id,
        trace.seconds(published.t_ns),
        trace.seconds(message.queued_ns),
        optional_seconds(delivery.t_ns, trace.t0_ns) if delivery else None,
        trace.seconds(end_ns),
        fate,
        reason,
        message.fragment_count,
        tuple(_fragment(trace, message, account, index) for index in sorted(account.attempts)),
        account.critical(),
        tuple(_part(trace, account, stretch) for stretch in account.stretches()),
        brought.carried.relays if brought else (),
        typical_s(trace, stream),
        tuple(_notes(trace, evidence, account, message)),
    )


def typical_s(trace: Trace, stream: Stream) -> float | None:
    """Median latency of a stream."""
    values = latencies_s(trace, stream.index)
    return percentile(values, 0.5) if values else None


def _end_ns(capture: Capture, delivery: Delivery | None, guess: QueuedMessage | None) -> int | None:
    end_ns = _end_ns_of(delivery, guess)
    return None if end_ns is None else min(end_ns, capture.end_ns)


def _end_ns_of(delivery: Delivery | None, message: QueuedMessage | None) -> int | None:
    if delivery is not None:
        return delivery.t_ns
    return message.ended_ns if message is not None else None


def _short(trace: Trace, stream: Stream, published: Published, delivery: Delivery | None, end_ns: int) -> Story:
    """Of a message that never came into its sender's queue, or of which its daemon told nothing."""
    fate, reason, notes = Fate.UNDELIVERED, "", ["the capture holds no daemon's word on it: not udp_mesh, or damaged"]
    if not published.accepted:
        fate, reason, notes, end_ns = Fate.REFUSED, published.reason or "", [], published.t_ns
        away = absences(trace, stream.source, stream.destination)
        notes += [s.words for s in away if s.from_ns <= published.t_ns < s.to_ns and s.words][:1]
    elif delivery is not None:
        fate = Fate.DELIVERED
    stretches = [Stretch(published.t_ns, end_ns, Cause.UNEXPLAINED)]
    stored = stored_by_order(trace, stream).get(published.seq)
    if stored is not None and delivery is None:  # it never left the store
        end_ns, notes = stored.ended_ns or end_ns, []
        fate, reason = (Fate.DROPPED, stored.outcome or "") if stored.ended_ns else (fate, "")
        away = absences(trace, stream.source, stream.destination)
        stretches = painted(in_store(stream.source, published.t_ns, stored, end_ns), away)
    parts = tuple(_plain_part(trace, stretch) for stretch in merged(stretches))
    return Story(
        stream,
        published.seq,
        published.size_bytes,
        None,
        trace.seconds(published.t_ns),
        None,
        trace.seconds(delivery.t_ns) if delivery else None,
        trace.seconds(end_ns),
        fate,
        reason,
        0,
        (),
        None,
        parts,
        (),
        typical_s(trace, stream),
        tuple(notes),
    )


def _fate(account: Account, message: QueuedMessage, delivery: Delivery | None) -> tuple[Fate, str]:
    if delivery is not None:
        return Fate.DELIVERED, ""
    if message.outcome == ACKED:
        return Fate.NOT_HANDED_OVER, ""
    if message.outcome is not None:
        return Fate.DROPPED, message.outcome
    if message.peer == EVERYBODY and account.attempts:
        return Fate.LOST, "broadcasts are not repeated"
    return Fate.UNDELIVERED, ""


def _plain_part(trace: Trace, stretch: Stretch) -> Part:
    return Part(stretch.cause, trace.seconds(stretch.from_ns), trace.seconds(stretch.to_ns), stretch.words)


def _part(trace: Trace, account: Account, stretch: Stretch) -> Part:
    ahead = account.lane.ahead(stretch.from_ns, stretch.to_ns) if stretch.cause is Cause.QUEUE else ()
    words = stretch.words or (behind(ahead) if stretch.cause is Cause.QUEUE else "")
    return Part(stretch.cause, trace.seconds(stretch.from_ns), trace.seconds(stretch.to_ns), words, ahead)


def _fragment(trace: Trace, message: QueuedMessage, account: Account, index: int) -> FragmentStory:
    tries = account.attempts[index]
    sent = tuple(
        _transmission(trace, message, attempt, previous)
        for attempt, previous in zip(tries, [None, *tries], strict=False)
    )
    arrived = optional_seconds(account.arrived_ns(index), trace.t0_ns)
    return FragmentStory(index, tries[0].departure.payload_bytes, sent, arrived)


def _transmission(trace: Trace, message: QueuedMessage, attempt: Attempt, previous: Attempt | None) -> Transmission:
    departure = attempt.departure
    return Transmission(
        departure.packet[1],
        _sending(trace, message, departure.t_ns, attempt, previous),
        trace.seconds(departure.t_ns),
        optional_seconds(attempt.carried.arrived_ns, trace.t0_ns),
        optional_seconds(attempt.acked_ns, trace.t0_ns),
        attempt.counts,
        tuple(HopStory.of(hop, trace.t0_ns) for hop in attempt.carried.hops),
        attempt.carried.relays,
    )


def _sending(trace: Trace, message: QueuedMessage, t_ns: int, attempt: Attempt, previous: Attempt | None) -> Sending:
    departure = attempt.departure
    if previous is None:
        return Sending.FIRST
    if (previous.departure.destination_tag, previous.departure.message_id) != (
        departure.destination_tag,
        departure.message_id,
    ):
        return Sending.ANEW
    key = (message.node, message.peer, departure.packet[1], departure.message_id, departure.index)
    return Sending.COPY if trace.daemons.is_copy(key, t_ns) else Sending.AGAIN


def _notes(trace: Trace, evidence: Evidence, account: Account, message: QueuedMessage) -> list[str]:
    notes = []
    if not account.attempts and message.outcome == ACKED:
        notes.append("no packet of it can be read: sealed by a key, or missing in the capture")
    attempts = [attempt for tries in account.attempts.values() for attempt in tries]
    if not evidence.has_verdicts and any(attempt.carried.arrived_ns is None for attempt in attempts):
        notes.append("this engine tells no verdicts: a frame that did not arrive was lost or found a queue full")
    if trace.daemons.events_lost:
        notes.append(f"{trace.daemons.events_lost} events of daemons are missing in the capture")
    return notes
