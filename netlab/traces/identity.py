"""Which message of a daemon's queue a publication became, and which publication a message in a queue was."""

from __future__ import annotations

from collections.abc import Iterable

from netlab.traces.daemon_log import QueuedMessage
from netlab.traces.evidence import Departure
from netlab.traces.model import EVERYBODY, Published, Stream, Trace

_SLACK_NS = 1_000_000
_ENVELOPE_BYTES = 256  # a stored message's envelope counts as part of it in the queue


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
    same = [s for s in trace.streams if _lane(s) == _lane(stream)]
    calls = [(entry, s.index) for s in same for entry in trace.published.get(s.index, []) if entry.accepted]
    calls.sort(key=lambda call: call[0].t_ns)
    found: dict[int, QueuedMessage] = {}
    queue, at = _queue(trace, stream), 0
    for entry, index in calls:
        while at < len(queue) and not _fits(queue[at], entry):
            if _since(queue[at]) >= entry.t_ns - _SLACK_NS:
                break  # another size: this publication never came into the queue
            at += 1
        if at < len(queue) and _fits(queue[at], entry):
            if index == stream.index:
                found[entry.seq] = queue[at]
            at += 1
    return found


def _lane(stream: Stream) -> tuple[str, str, str]:
    return stream.source, stream.destination, stream.topic


def _queue(trace: Trace, stream: Stream) -> list[QueuedMessage]:
    mine = (stream.destination, EVERYBODY)
    queued = trace.daemons.queued.get(stream.source, [])
    return [message for message in queued if message.topic == stream.topic and message.peer in mine]


def _since(message: QueuedMessage) -> int:
    return message.queued_ns if message.stored_ns is None else message.stored_ns


def _fits(message: QueuedMessage, entry: Published) -> bool:
    is_later = _since(message) >= entry.t_ns - _SLACK_NS
    return is_later and 0 <= message.size_bytes - entry.size_bytes <= _ENVELOPE_BYTES
