"""What a message waited for inside its sender: who left before it, its own pace, its topic's limit, others' backlogs.

The time until a packet leaves belongs to that packet: while it was first in the queue, everything behind it waited for
its turn too. So the wait of a message is divided at the departures to the same destination: what ends with another
message's packet was spent behind that message; what ends with its own, on window and pace.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

from netlab.traces.causes import Cause, Stretch, painted
from netlab.traces.daemon_log import QueuedMessage
from netlab.traces.evidence import Departure, Evidence
from netlab.traces.model import Trace

_BACKLOG_HOLDS_NS = 250_000_000  # udp_mesh.core.coordination.HOLD_S


@dataclass(frozen=True, slots=True)
class Ahead:
    """A message that went before, with what left of it meanwhile. ``seq`` is None if nothing tells."""

    topic: str
    priority: int
    message_id: int
    seq: int | None
    fragments: int
    payload_bytes: int

    def __str__(self) -> str:
        """Name it for a person."""
        name = f"{self.topic} #{self.seq}" if self.seq is not None else f"{self.topic or 'message'} m{self.message_id}"
        return f"{name} ({size_text(self.payload_bytes)})"

    def with_more(self, more: Ahead) -> Ahead:
        """Add what left of the same message at another time."""
        size_bytes, seq = self.payload_bytes + more.payload_bytes, more.seq if self.seq is None else self.seq
        return replace(self, seq=seq, fragments=self.fragments + more.fragments, payload_bytes=size_bytes)


def size_text(size_bytes: int) -> str:
    """A size for a person."""
    return f"{size_bytes / 1000:.1f} kB" if size_bytes >= 1000 else f"{size_bytes} B"


class Sender:
    """The sender of one message as its packets and its daemon show it.

    Args:
        trace: Of the run.
        evidence: Of the sender.
        message: In its queue.
        tags: Low halves of the epochs that its destination had.
        frame_ns: How long a frame takes on its link by itself.
    """

    def __init__(
        self,
        trace: Trace,
        evidence: Evidence,
        message: QueuedMessage,
        tags: set[int],
        frame_ns: Callable[[Departure], int],
    ) -> None:
        self._trace, self._evidence, self._message, self._frame_ns = trace, evidence, message, frame_ns
        self._own_ids = message.ids_on_wire
        self._lane = [d for d in evidence.departures if d.destination_tag in tags or d.destination_tag == 0]
        self._seqs = {(d.packet[0], d.message_id): d.traffic for d in evidence.departures if d.traffic is not None}

    def wait(self, from_ns: int, to_ns: int) -> list[Stretch]:
        """Divide the time in which a fragment of the message waited to leave, up to its departure."""
        out: list[Stretch] = []
        start_ns = from_ns
        sent = _Own(self)
        others = self._yielding
        for t_ns, pieces in groupby(self._between(from_ns, to_ns), key=lambda d: d.t_ns):
            own = next((piece for piece in pieces if piece.message_id in self._own_ids), None)
            out += painted(sent.turn(own, start_ns), others) if own else [Stretch(start_ns, t_ns, Cause.QUEUE)]
            start_ns = t_ns
        return [*out, *painted(sent.last_turn(start_ns, to_ns), others)]

    def frame_ns(self, departure: Departure) -> int:
        """How long a frame takes on its link by itself."""
        return self._frame_ns(departure)

    def ahead(self, from_ns: int, to_ns: int) -> tuple[Ahead, ...]:
        """The other messages of which packets left in (from, to], the one with the most bytes first."""
        return self.named(d for d in self._between(from_ns + 1, to_ns + 1) if d.message_id not in self._own_ids)

    def named(self, departures: Iterable[Departure]) -> tuple[Ahead, ...]:
        """Sum up departures by message, the one with the most bytes first."""
        fragments: Counter[tuple[int, int]] = Counter()
        sizes: Counter[tuple[int, int]] = Counter()
        about: dict[tuple[int, int], Departure] = {}
        for departure in departures:
            key = (departure.packet[0], departure.message_id)
            fragments[key] += 1
            sizes[key] += departure.payload_bytes
            about[key] = departure
        return tuple(self._ahead(about[key], fragments[key], size) for key, size in sizes.most_common())

    @cached_property
    def _yielding(self) -> list[Stretch]:
        """When other nodes' more urgent backlogs held this message back, as far as the sender heard them."""
        names = self._trace.daemons.epochs()
        return [
            Stretch(
                heard.t_ns,
                heard.t_ns + _BACKLOG_HOLDS_NS,
                Cause.YIELDING,
                f"{names.get(heard.from_epoch, 'another node')} had something of priority {heard.priority} waiting",
            )
            for heard in self._evidence.backlogs
            if heard.priority < self._message.priority
        ]

    def pacing_words(self, t_ns: int) -> str:
        """What the daemon last said of its window before then."""
        windows = self._trace.windows.get((self._message.node, self._message.peer), [])
        index = bisect_right(windows, t_ns, key=lambda window: window.t_ns)
        if not index:
            return "for window or pace"
        window = windows[index - 1]
        told = f"{size_text(int(window.in_flight_bytes))} of {size_text(int(window.cwnd_bytes))} in flight"
        return f"for window or pace ({told} at {self._trace.seconds(window.t_ns):.3f} s)"

    def _between(self, from_ns: int, to_ns: int) -> Iterator[Departure]:
        start = bisect_left(self._lane, from_ns, key=lambda d: d.t_ns)
        for departure in self._lane[start:]:
            if departure.t_ns >= to_ns:
                return
            yield departure

    def _ahead(self, departure: Departure, fragments: int, payload_bytes: int) -> Ahead:
        told = self._seqs.get((departure.packet[0], departure.message_id))
        topic = departure.topic or self._trace.daemons.topic_of(departure.node, departure.message_id, departure.t_ns)
        seq = told[1] if told else None
        return Ahead(topic, departure.priority, departure.message_id, seq, fragments, payload_bytes)


class _Own:
    """The turns of a message's own packets: what their frames take is sending, the rest is window and pace.

    Frames that left closer together than the link takes are made up for by the waits after them.
    """

    def __init__(self, sender: Sender) -> None:
        self._sender = sender
        self._credit_ns = 0
        self._left: set[tuple[int, int, int]] = set()

    def turn(self, departure: Departure, start_ns: int) -> list[Stretch]:
        """The wait of one of its fragments that left."""
        fragment = (departure.destination_tag, departure.message_id, departure.index)
        if fragment in self._left:
            words = f"its fragment {departure.index + 1}/{departure.count} left again"
            return [Stretch(start_ns, departure.t_ns, Cause.LOSS, words)]
        self._left.add(fragment)
        out = self.last_turn(start_ns, departure.t_ns)
        self._credit_ns += self._sender.frame_ns(departure)
        return out

    def last_turn(self, start_ns: int, end_ns: int) -> list[Stretch]:
        """The wait up to a departure, after what has left before."""
        sending_ns = min(self._credit_ns, end_ns - start_ns)
        self._credit_ns -= sending_ns
        words = self._sender.pacing_words(end_ns)
        return [
            Stretch(start_ns, start_ns + sending_ns, Cause.SENDING),
            Stretch(start_ns + sending_ns, end_ns, Cause.PACING, words),
        ]


def merged_ahead(ahead: Iterable[Ahead]) -> list[Ahead]:
    """Sum up what several waits name, by message, the one with the most bytes first."""
    found: dict[int, Ahead] = {}
    for entry in ahead:
        old = found.get(entry.message_id)
        found[entry.message_id] = entry if old is None else old.with_more(entry)
    return sorted(found.values(), key=lambda entry: -entry.payload_bytes)


def behind(ahead: Iterable[Ahead], *, most: int = 3) -> str:
    """Say behind what something waited."""
    named = list(ahead)
    if not named:
        return "behind other frames"
    total = sum(entry.payload_bytes for entry in named)
    text = ", ".join(map(str, named[:most]))
    return f"behind {text}" + (f" and {len(named) - most} more, {size_text(total)} in all" if named[most:] else "")


Naming = Callable[[Iterable[Departure]], tuple[Ahead, ...]]
