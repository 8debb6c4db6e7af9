"""Why a message took the time it took: the causes, and stretches of time that belong to one of them. Values only."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum


class Cause(StrEnum):
    """What a part of a message's delay went to; docs/captures.md tells how each is measured."""

    HANDOVER = "handover"
    """From the publish call until the daemon had it in its queue."""
    RATE_LIMIT = "rate_limit"
    """Held back by its topic's rate limit."""
    QUEUE = "queue"
    """Others to the same destination left before it."""
    PACING = "pacing"
    """First in the queue, and waiting for window or pace."""
    YIELDING = "yielding"
    """First in the queue, and leaving the medium to another node's more urgent backlog."""
    SENDING = "sending"
    """Its own other fragments left one after the other."""
    LOSS = "loss"
    """A fragment was lost on the way; until it left again."""
    QUEUE_FULL = "queue_full"
    """A fragment found the link's queue full; until it left again."""
    OUTAGE = "outage"
    OUT_OF_RANGE = "out_of_range"
    RESTART = "restart"
    """A daemon at one end was down, or had forgotten what it had."""
    PEER_ABSENT = "peer_absent"
    """The destination was offline, and nothing in the capture says why."""
    RECONNECT = "reconnect"
    """The path was there again, and the sender did not know or had not tried yet."""
    LINK_QUEUE = "link_queue"
    """In the queue of the link or the radio, behind other frames or waiting for the channel."""
    RADIO_RETRIES = "radio_retries"
    """An 802.11 radio sent the frame several times before it was heard."""
    TRANSMISSION = "transmission"
    """The frame's own time on the link."""
    PROPAGATION = "propagation"
    """The link's delay."""
    RELAY = "relay"
    """Inside nodes that passed it on."""
    REASSEMBLY = "reassembly"
    """From the last fragment's arrival until the application had the message."""
    UNEXPLAINED = "unexplained"


#: What a message takes when nothing stands in its way.
INHERENT = frozenset({Cause.SENDING, Cause.TRANSMISSION, Cause.PROPAGATION})


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of time with its cause, CLOCK_REALTIME; ``words`` say what happened in it."""

    from_ns: int
    to_ns: int
    cause: Cause
    words: str = ""


def painted(base: Iterable[Stretch], over: Iterable[Stretch]) -> list[Stretch]:
    """Lay stretches over others: where both are, the upper one counts; of the upper ones the first.

    The whole covers what ``base`` covers, neither more nor less.
    """
    upper = list(over)
    out: list[Stretch] = []
    for stretch in base:
        out += _split(stretch, upper)
    return out


def _split(stretch: Stretch, upper: list[Stretch]) -> list[Stretch]:
    if stretch.from_ns >= stretch.to_ns:
        return []
    for number, top in enumerate(upper):
        start, end = max(stretch.from_ns, top.from_ns), min(stretch.to_ns, top.to_ns)
        if start < end:
            rest = upper[number + 1 :]
            before, after = replace(stretch, to_ns=start), replace(stretch, from_ns=end)
            return [*_split(before, rest), replace(top, from_ns=start, to_ns=end), *_split(after, rest)]
    return [stretch]


def merged(stretches: Iterable[Stretch]) -> list[Stretch]:
    """Join neighbours of the same cause and the same words; drop those without length."""
    out: list[Stretch] = []
    for stretch in stretches:
        if stretch.from_ns >= stretch.to_ns:
            continue
        last = out[-1] if out else None
        if last and (last.cause, last.words, last.to_ns) == (stretch.cause, stretch.words, stretch.from_ns):
            out[-1] = replace(last, to_ns=stretch.to_ns)
        else:
            out.append(stretch)
    return out
