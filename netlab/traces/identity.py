"""Which message of a daemon's queue a publication became, and which publication a message in a queue was."""

from __future__ import annotations

from collections.abc import Iterable

from netlab.traces.daemon_log import QueuedMessage, StoredMessage
from netlab.traces.evidence import Departure
from netlab.traces.model import EVERYBODY, Published, Stream, Trace

_SLACK_NS = 1_000_000
_ENVELOPE_BYTES = 64  # an envelope counts as part of the message in the queue


def queued_message(
    trace: Trace, stream: Stream, published: Published, departures: Iterable[Departure] = ()
) -> QueuedMessage | None:
    """Find the queued message of one publication to one destination; None if it never came into the queue.

    A fragment that left proves it; without one the order of publications tells, which is also that of the queue.
    """
    queue = _queue(trace, stream)
    proof = (published.publication, published.seq)
    for departure in departures:
        if departure.traffic == proof:
            fitting = [m for m in queue if departure.message_id in m.ids_on_wire and m.queued_ns <= departure.t_ns]
            if fitting:
                return fitting[-1]
    return by_order(trace, stream).get(published.seq)


def by_order(trace: Trace, stream: Stream) -> dict[int, QueuedMessage]:
    """The queued messages of a stream's publications by ``seq``, told by order, time and size."""
    kept = {id(stored): seq for seq, stored in stored_by_order(trace, stream).items()}
    if kept:
        queue = _queue(trace, stream)
        return {kept[id(m.stored)]: m for m in queue if m.stored is not None and id(m.stored) in kept}
    calls = _calls(trace, stream)
    found: dict[int, QueuedMessage] = {}
    queue, at = _queue(trace, stream), 0
    for entry, index in calls:
        while at < len(queue) and not _fits(queue[at], entry):
            if queue[at].queued_ns >= entry.t_ns - _SLACK_NS:
                break  # another size: this publication never came into the queue
            at += 1
        if at < len(queue) and _fits(queue[at], entry):
            if index == stream.index:
                found[entry.seq] = queue[at]
            at += 1
    return found


def stored_by_order(trace: Trace, stream: Stream) -> dict[int, StoredMessage]:
    """The stored messages of a stream's publications by ``seq``: the store takes them in order."""
    kept = trace.daemons.stored.get((stream.source, stream.destination, stream.topic), [])
    calls = _calls(trace, stream)
    return {entry.seq: stored for (entry, index), stored in zip(calls, kept, strict=False) if index == stream.index}


def _calls(trace: Trace, stream: Stream) -> list[tuple[Published, int]]:
    """The accepted publications of all streams of the same lane, with their streams, in the order of time."""
    same = [s for s in trace.streams if _lane(s) == _lane(stream)]
    calls = [(entry, s.index) for s in same for entry in trace.published.get(s.index, []) if entry.accepted]
    return sorted(calls, key=lambda call: call[0].t_ns)


def _lane(stream: Stream) -> tuple[str, str, str]:
    return stream.source, stream.destination, stream.topic


def _queue(trace: Trace, stream: Stream) -> list[QueuedMessage]:
    mine = (stream.destination, EVERYBODY)
    queued = trace.daemons.queued.get(stream.source, [])
    return [message for message in queued if message.topic == stream.topic and message.peer in mine]


def _fits(message: QueuedMessage, entry: Published) -> bool:
    """Compressed messages are smaller than what was published, those with an envelope larger."""
    return message.queued_ns >= entry.t_ns - _SLACK_NS and message.size_bytes <= entry.size_bytes + _ENVELOPE_BYTES
