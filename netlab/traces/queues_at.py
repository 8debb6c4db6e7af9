"""What the queues held at one moment: in every sender's daemon, and in the links."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass

from netlab.capture.records import VerdictRecord
from netlab.traces.daemon_log import QueuedMessage
from netlab.traces.model import Interface, Trace, Window


@dataclass(frozen=True, slots=True)
class Waiting:
    """The messages of one topic that a node still had to bring to a destination; partly sent ones count whole.

    ``held``: those that the topic's rate limit kept back. ``oldest_s``: how long the first had waited.
    """

    node: str
    peer: str
    topic: str
    priority: int
    messages: int
    size_bytes: int
    oldest_s: float
    held: int


@dataclass(frozen=True, slots=True)
class InLink:
    """Frames that had left an interface and not arrived: in the link's queue or on the way."""

    sender: Interface
    receiver: Interface
    frames: int
    size_bytes: int


@dataclass(frozen=True, slots=True)
class Queues:
    """All of it at one moment. ``windows``: what each daemon had said last, by node and peer."""

    t_ns: int
    waiting: tuple[Waiting, ...]
    in_links: tuple[InLink, ...]
    windows: dict[tuple[str, str], Window]


def queues_at(trace: Trace, t_ns: int, verdicts: Iterable[VerdictRecord]) -> Queues:
    """Answer from the daemons' events and the medium's decisions.

    Args:
        trace: Of the run.
        t_ns: The moment, CLOCK_REALTIME.
        verdicts: Those of the seconds before it. Without any, the links are not told.
    """
    waiting = [entry for node in sorted(trace.daemons.queued) for entry in _waiting(trace, node, t_ns)]
    windows = {}
    for pair, told in trace.windows.items():
        index = bisect_right(told, t_ns, key=lambda window: window.t_ns)
        if index:
            windows[pair] = told[index - 1]
    return Queues(t_ns, tuple(waiting), tuple(_in_links(verdicts, t_ns)), windows)


def _waiting(trace: Trace, node: str, t_ns: int) -> list[Waiting]:
    found: dict[tuple[str, int, str], list[QueuedMessage]] = {}
    for message in trace.daemons.waiting(node, t_ns):
        found.setdefault((message.peer, message.priority, message.topic), []).append(message)
    return [
        Waiting(
            node,
            peer,
            topic,
            priority,
            len(messages),
            sum(message.size_bytes for message in messages),
            (t_ns - messages[0].queued_ns) / 1e9,
            sum(message.is_held(t_ns) for message in messages),
        )
        for (peer, priority, topic), messages in sorted(found.items())
    ]


def _in_links(verdicts: Iterable[VerdictRecord], t_ns: int) -> list[InLink]:
    found: dict[tuple[Interface, Interface], list[int]] = {}
    for verdict in verdicts:
        if verdict.t_ns <= t_ns < verdict.departs_ns:
            found.setdefault((verdict.sender, verdict.receiver), []).append(verdict.length)
    return [InLink(*pair, len(lengths), sum(lengths)) for pair, lengths in sorted(found.items())]
