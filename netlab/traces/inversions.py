"""Priority inversions: a less urgent fragment left while a more urgent message waited.

A data fragment F on an interface of node N is an inversion if some message M that an application at N published

1. is more urgent: its priority number is lower than F's;
2. was published more than 1 ms plus the serialisation of one fragment (F's frame at the rate of F's interface) before
   F's capture time: nobody can call back a fragment that is already on its way to the wire;
3. still had an unsent fragment at that time: F lies before the first transmission of M's last fragment. A message that
   was never sent as a whole waits until its sender gave it up, or until its stream's next publication;
4. was accepted from the application, and its destination was online in N's eyes;
5. was inside its destination's window. A fragment F to the same destination shows that the window had room. For others
   the daemon's latest report (at most ten per second) tells: no room means in flight + F's size > cwnd.

Publish times come from the traffic process, capture times from the kernel; the daemon's claims only ever excuse.
F may be a retransmission: these queue at their own priority. Each F counts once.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from netlab.traces.model import NS_PER_S, Fragment, Published, Stream, Trace

GRACE_NS = 1_000_000


@dataclass(frozen=True, slots=True)
class Inversion:
    """The fragment that should have waited, and a message that should have gone first."""

    fragment: Fragment
    stream: Stream
    seq: int
    published_ns: int

    @property
    def waited_s(self) -> float:
        """How long the urgent message had been waiting."""
        return (self.fragment.t_ns - self.published_ns) / NS_PER_S


def inversions(trace: Trace, node: str) -> list[Inversion]:
    """All inversions at a node, in the order of time."""
    fragments = trace.fragments.get(node, [])
    queues = [_Queue(trace, stream, fragments) for stream in trace.streams if stream.source == node]
    queues.sort(key=lambda queue: queue.stream.priority)
    found = []
    for fragment in fragments:
        serialisation_ns = _serialisation_ns(trace, fragment)
        for queue in queues:
            if queue.stream.priority >= fragment.priority:
                break
            waiting = queue.waiting(fragment.t_ns, published_before_ns=fragment.t_ns - GRACE_NS - serialisation_ns)
            if waiting and _could_go(trace, queue.stream, fragment):
                found.append(Inversion(fragment, queue.stream, waiting.seq, waiting.t_ns))
                break
    return found


class _Queue:
    """The accepted messages of one stream with the times at which their last fragment first left."""

    def __init__(self, trace: Trace, stream: Stream, fragments: list[Fragment]) -> None:
        self.stream = stream
        published = [entry for entry in trace.published.get(stream.index, []) if entry.accepted]
        self._published_ns = [entry.t_ns for entry in published]
        ends = _ends_ns(trace, stream, published, fragments)
        # The latest end among the first k messages, and whose it is: one look answers "does any of them still wait?".
        self._latest: list[tuple[int, Published]] = []
        for end_ns, entry in zip(ends, published, strict=True):
            if not self._latest or end_ns > self._latest[-1][0]:
                self._latest.append((end_ns, entry))
            else:
                self._latest.append(self._latest[-1])

    def waiting(self, t_ns: int, *, published_before_ns: int) -> Published | None:
        """A message published before then that still waits at ``t_ns``."""
        count = bisect_left(self._published_ns, published_before_ns)
        if count and self._latest[count - 1][0] > t_ns:
            return self._latest[count - 1][1]
        return None


def _ends_ns(trace: Trace, stream: Stream, published: list[Published], fragments: list[Fragment]) -> list[int]:
    last_sent = _last_sent_ns(trace, stream, fragments)
    ends = []
    for position, entry in enumerate(published):
        message_id, end_ns = last_sent.get((entry.publication, entry.seq), (None, None))
        if end_ns is None:
            is_last = position + 1 == len(published)
            end_ns = trace.end_ns if is_last else published[position + 1].t_ns
            given_up = [] if message_id is None else trace.dropped_ns.get((stream.source, message_id), [])
            end_ns = min([end_ns, *(time for time in given_up if time >= entry.t_ns)])
        ends.append(end_ns)
    return ends


def _last_sent_ns(
    trace: Trace, stream: Stream, fragments: list[Fragment]
) -> dict[tuple[int, int], tuple[int, int | None]]:
    """(publication, seq) -> (message id, first transmission of its last fragment or None if some were never sent)."""
    first_ns: dict[tuple[int, int], dict[int, int]] = {}
    about: dict[tuple[int, int], Fragment] = {}
    for fragment in fragments:
        if fragment.message is not None and trace.is_for(fragment, stream):
            first_ns.setdefault(fragment.message, {}).setdefault(fragment.index, fragment.t_ns)
            about[fragment.message] = fragment
    return {
        message: (about[message].message_id, max(times.values()) if len(times) == about[message].count else None)
        for message, times in first_ns.items()
    }


def _could_go(trace: Trace, stream: Stream, fragment: Fragment) -> bool:
    pair = (stream.source, stream.destination)
    presence = trace.presence.get(pair)
    # A daemon that never reports peers excuses nothing; for one that does, a peer that it never met is not online.
    reports = presence is not None or any(node == stream.source for node, _ in trace.presence)
    if reports and (presence is None or not presence.at(fragment.t_ns)):
        return False
    if fragment.destination == stream.destination:
        return True
    windows = trace.windows.get(pair, [])
    index = bisect_right(windows, fragment.t_ns, key=lambda window: window.t_ns)
    if not index:
        return True
    window = windows[index - 1]
    return window.in_flight_bytes + fragment.frame_bytes <= window.cwnd_bytes


def _serialisation_ns(trace: Trace, fragment: Fragment) -> int:
    rate_bps = trace.rate_bps(fragment.interface, fragment.t_ns)
    return round(fragment.frame_bytes * 8 / rate_bps * NS_PER_S) if rate_bps else 0
