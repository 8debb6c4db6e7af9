"""Which message a person means: by name, or the slowest or the first lost one among those that filters leave."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from netlab.capture.view import Filter
from netlab.errors import NetlabError
from netlab.traces.model import Published, Stream, Trace
from netlab.traces.streams import first_deliveries

HELP = "TOPIC#SEQ (as in: telemetry#20, or pasted from the list: 'telemetry robot1->base #20'), slowest, or lost"
_ENDS = re.compile(r"(\S+)->(\S+)")
_NUMBER = re.compile(r"#(\d+)")
_MOST_NAMED = 12


class NoSuchMessage(NetlabError):
    """The question names no message, or several; the text says what there is."""


@dataclass(frozen=True, slots=True)
class _Wanted:
    topic: str
    seq: int | None
    ends: tuple[str, str] | None


def choose_message(trace: Trace, text: str, chosen: Filter) -> tuple[Stream, Published]:
    """Find the message that a person means.

    Args:
        trace: With or without packets.
        text: See ``HELP``; ``slowest`` and ``lost`` (the first that was not delivered) look among what the filter
            leaves, and so does a topic without a number: its slowest.
        chosen: Streams and times.

    Raises:
        NoSuchMessage: There is none, or more than one.
    """
    if not trace.streams:
        raise NoSuchMessage(f"{trace.path}: no messages: the capture tells of no streams of netlab's own traffic")
    wanted = _Wanted("", None, None) if text in ("slowest", "lost") else _parsed(trace, text)
    streams = [s for s in trace.streams if _fits(s, wanted) and fits(s, chosen)]
    if not streams:
        raise NoSuchMessage(f"no stream is left of these choices; {_streams(trace.streams)}")
    if wanted.seq is not None:
        return _numbered(trace, wanted, streams)
    candidates = list(_candidates(trace, streams, chosen))
    if not candidates:
        raise NoSuchMessage(f"nothing was published in that time on {_streams(streams)}")
    return _lost(trace, candidates) if text == "lost" else _slowest(trace, candidates)


def fits(stream: Stream, chosen: Filter) -> bool:
    """Whether a stream is among the chosen ones: node and peer are its ends, in either order."""
    ends = {stream.source, stream.destination}
    return (
        all(name is None or name in ends for name in (chosen.node, chosen.peer))
        and chosen.topic in (None, stream.topic)
        and chosen.priority in (None, stream.priority)
    )


def in_time(trace: Trace, t_ns: int, chosen: Filter) -> bool:
    """Whether a moment is within the chosen time."""
    at_s = trace.seconds(t_ns)
    return (chosen.from_s is None or at_s >= chosen.from_s) and (chosen.to_s is None or at_s < chosen.to_s)


def _parsed(trace: Trace, text: str) -> _Wanted:
    ends, number = _ENDS.search(text), _NUMBER.search(text)
    topic = _NUMBER.sub("", _ENDS.sub("", text)).strip()
    topics = sorted({stream.topic for stream in trace.streams})
    if topic and topic not in topics:
        raise NoSuchMessage(
            f"no topic '{topic}' in this capture; topics are {', '.join(topics)}. To name a message: {HELP}"
        )
    if not topic and not ends and number is None:
        raise NoSuchMessage(f"'{text}' names no message. To name one: {HELP}")
    return _Wanted(topic, int(number[1]) if number else None, (ends[1], ends[2]) if ends else None)


def _fits(stream: Stream, wanted: _Wanted) -> bool:
    return wanted.topic in ("", stream.topic) and wanted.ends in (None, (stream.source, stream.destination))


def _numbered(trace: Trace, wanted: _Wanted, streams: list[Stream]) -> tuple[Stream, Published]:
    assert wanted.seq is not None
    found = [(s, p) for s in streams if (p := trace.find_published(s.index, wanted.seq)) is not None]
    if len(found) == 1:
        return found[0]
    name = f"{wanted.topic} #{wanted.seq}".strip()
    if not found:
        published = [(s, trace.published.get(s.index, [])) for s in streams]
        told = [f"{s}: #{e[0].seq} to #{e[-1].seq}" if e else f"{s}: none" for s, e in published]
        raise NoSuchMessage(f"{name} was never published; published were {_some(told)}")
    told = [f"'{s} #{wanted.seq}'" for s, _ in found]
    raise NoSuchMessage(
        f"{name} means {len(found)} messages; name one of {_some(told)}, or narrow down with --node, --peer"
    )


def _candidates(trace: Trace, streams: list[Stream], chosen: Filter) -> Iterator[tuple[Stream, Published]]:
    for stream in streams:
        for entry in trace.published.get(stream.index, []):
            if in_time(trace, entry.t_ns, chosen):
                yield stream, entry


def _slowest(trace: Trace, candidates: list[tuple[Stream, Published]]) -> tuple[Stream, Published]:
    latency = {
        (stream.index, delivery.seq): delivery.latency_s
        for stream in {stream.index: stream for stream, _ in candidates}.values()
        for delivery in first_deliveries(trace, stream.index)
    }
    delivered = [pair for pair in candidates if (pair[0].index, pair[1].seq) in latency]
    if not delivered:
        raise NoSuchMessage("none of these messages was delivered; ask --why lost for the first of them")
    return max(delivered, key=lambda pair: latency[pair[0].index, pair[1].seq])


def _lost(trace: Trace, candidates: list[tuple[Stream, Published]]) -> tuple[Stream, Published]:
    got = {(s.index, d.seq) for s in trace.streams for d in trace.delivered.get(s.index, [])}
    missing = [pair for pair in candidates if (pair[0].index, pair[1].seq) not in got]
    if not missing:
        raise NoSuchMessage("all of these messages were delivered; ask --why slowest for the slowest of them")
    return min(missing, key=lambda pair: pair[1].t_ns)


def _streams(streams: tuple[Stream, ...] | list[Stream]) -> str:
    return f"streams are {_some([str(stream) for stream in streams])}"


def _some(names: list[str]) -> str:
    more = f" and {len(names) - _MOST_NAMED} more" if names[_MOST_NAMED:] else ""
    return ", ".join(names[:_MOST_NAMED]) + more
