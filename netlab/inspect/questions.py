"""The questions of ``netlab inspect``: each reads what it needs of the capture and yields the answer's lines.

Nothing is printed here. What is wrong with the file goes to ``Asked.note``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord, VerdictRecord
from netlab.capture.view import Filter, View
from netlab.errors import NetlabError
from netlab.inspect import answers
from netlab.inspect.choose import choose_message, fits, in_time
from netlab.inspect.display import matching
from netlab.inspect.records import record_lines
from netlab.inspect.story_text import story_json, story_table, story_text
from netlab.inspect.table import Format, Table, csv_lines
from netlab.traces.conversations import Conversations
from netlab.traces.drops import Drops
from netlab.traces.drops import drops as all_drops
from netlab.traces.evidence import gather_all
from netlab.traces.load import load_trace, read_trace
from netlab.traces.messages import message_lives
from netlab.traces.model import Trace
from netlab.traces.queues_at import queues_at as all_queues
from netlab.traces.routes import Routes
from netlab.traces.tell import tell

_SLICE_NS = 5_000_000_000
_LONGEST_WAY_NS = 2_000_000_000  # from a datagram's departure to its arrival
_IN_LINKS_NS = 10_000_000_000  # nothing stays longer in a link


@dataclass(frozen=True, slots=True)
class Asked:
    """Of which file, with which filters, in which form, at most how many rows or records, and for how wide a screen."""

    file: Path
    chosen: Filter
    form: Format
    limit: int | None
    width: int
    note: Callable[[str], None]

    def times(self, trace: Trace) -> tuple[int, int]:
        """The chosen time as CLOCK_REALTIME: from, up to before."""
        from_s, to_s = self.chosen.from_s, self.chosen.to_s
        start_ns = 0 if from_s is None else max(0, trace.t0_ns + round(from_s * 1e9))
        return start_ns, 1 << 62 if to_s is None else max(0, trace.t0_ns + round(to_s * 1e9))


def why(asked: Asked, message: str) -> Iterator[str]:
    """The story of one message."""
    with Capture.open(asked.file) as capture:
        trace = read_trace(capture, with_packets=False)
        stream, published = choose_message(trace, message, asked.chosen)
        story = tell(capture, trace, stream, published)
        _note_all(asked, capture.notes)
    if asked.form is Format.JSON:
        yield json.dumps(story_json(story))
    elif asked.form is Format.CSV:
        yield story_table(story).csv().rstrip("\n")
    else:
        yield story_text(story, width=asked.width)


def conversations(asked: Asked) -> Iterator[str]:
    """Who talked to whom.

    Raises:
        NetlabError: Messages are chosen; frames of one topic have no conversation of their own.
    """
    if asked.chosen.chooses_messages:
        raise NetlabError("--conversations counts frames: --node, --peer, --from and --to choose among them, no topic")
    with Capture.open(asked.file) as capture:
        trace = read_trace(capture, with_packets=False)
        found = Conversations(trace)
        start_ns, end_ns = asked.times(trace)
        for record in capture.records({Kind.PACKET}, start_ns=start_ns, end_ns=end_ns):
            if isinstance(record, PacketRecord):
                found.packet(record)
        _note_all(asked, capture.notes)
    ends = {asked.chosen.node, asked.chosen.peer} - {None}
    talks = [talk for talk in found.result() if ends <= {talk.a, talk.b}]
    yield from _table(asked, answers.conversations_table(trace, talks))


def drops(asked: Asked) -> Iterator[str]:
    """What was dropped, by place and reason."""
    with Capture.open(asked.file) as capture:
        has_verdicts = _has_verdicts(capture)
        trace = read_trace(capture, with_packets=not has_verdicts)
        verdicts = _verdicts(capture, *asked.times(trace)) if has_verdicts else iter(())
        found = all_drops(trace, verdicts, chosen=lambda t_ns: in_time(trace, t_ns, asked.chosen))
        _note_all(asked, capture.notes)
    kept = [entry for entry in found if _is_chosen(entry, asked.chosen)]
    yield from _table(asked, answers.drops_table(trace, kept, is_for_people=asked.form is Format.TEXT))


def queues_at(asked: Asked, at_s: float) -> Iterator[str]:
    """What the queues held at a scenario time.

    Raises:
        NetlabError: The capture does not reach that time.
    """
    with Capture.open(asked.file) as capture:
        trace = read_trace(capture, with_packets=False)
        t_ns = trace.t0_ns + round(at_s * 1e9)
        if t_ns > capture.end_ns:
            raise NetlabError(f"--queues-at {at_s:g}s: the capture ends at {trace.seconds(capture.end_ns):.3f} s")
        has_verdicts = _has_verdicts(capture)
        found = all_queues(trace, t_ns, _verdicts(capture, max(0, t_ns - _IN_LINKS_NS), t_ns + 1))
        _note_all(asked, capture.notes)
    tables = answers.queues_tables(trace, answers.of_chosen(found, asked.chosen), has_verdicts=has_verdicts)
    if asked.form is Format.TEXT:
        yield "\n\n".join(table.text(width=asked.width) for table in tables)
    elif asked.form is Format.JSON:
        parts = zip(("waiting", "in_links", "windows"), tables, strict=True)
        yield json.dumps({"kind": "queues", "t_s": at_s, **{name: list(table.rows) for name, table in parts}})
    else:
        yield tables[0].csv().rstrip("\n")


def routes(asked: Asked) -> Iterator[str]:
    """Which relays carried the data."""
    with Capture.open(asked.file) as capture:
        trace = read_trace(capture, with_packets=False)
        streams = [stream for stream in trace.streams if fits(stream, asked.chosen)]
        found = Routes(trace)
        for start_ns, end_ns in _slices(capture, *asked.times(trace)):
            sources = {stream.source for stream in streams}
            upto_ns = end_ns + _LONGEST_WAY_NS
            evidence = gather_all(capture, sources, start_ns=start_ns, end_ns=upto_ns, with_verdicts=False)
            for source in sources:
                ours = [stream for stream in streams if stream.source == source]
                destinations, topics = {stream.destination for stream in ours}, {stream.topic for stream in ours}
                found.take(evidence[source], destinations, until_ns=end_ns, topics=topics)
        _note_all(asked, capture.notes)
    yield from _table(asked, answers.routes_table(trace, found.result()))


def display(asked: Asked, expression: str) -> Iterator[str]:
    """The packets that match a display filter of Wireshark."""
    with Capture.open(asked.file) as capture, matching(capture, expression) as found:
        view = View(capture, asked.chosen)
        chosen = (record for record in found if view.wants(record))
        yield from record_lines(view, islice(chosen, asked.limit), Kind.PACKET, asked.form)
        _note_all(asked, capture.notes)


def records(asked: Asked, kinds: set[Kind]) -> Iterator[str]:
    """Records of one family, in the order of time."""
    with Capture.open(asked.file) as capture:
        view = View(capture, asked.chosen)
        yield from record_lines(view, islice(view.records(kinds), asked.limit), min(kinds), asked.form)
        _note_all(asked, capture.notes)


def messages(asked: Asked) -> Iterator[str]:
    """Every message in a line."""
    trace, chosen = load_trace(asked.file), asked.chosen
    all_lives = message_lives(trace)
    wanted = (life for life in all_lives if fits(life.stream, chosen) and in_time(trace, life.published.t_ns, chosen))
    lives = islice(wanted, asked.limit)
    if asked.form is Format.TEXT:
        yield from (answers.message_text(trace, life) for life in lives)
    elif asked.form is Format.JSON:
        yield from (json.dumps(answers.message_row(trace, life)) for life in lives)
    else:
        rows = (answers.message_row(trace, life) for life in lives)
        yield from (line.rstrip("\n") for line in csv_lines(answers.MESSAGE_KEYS, rows))
    _note_all(asked, trace.notes)


def _slices(capture: Capture, start_ns: int, end_ns: int) -> Iterator[tuple[int, int]]:
    """A time cut up, so that the packets of one slice at a time are held."""
    end_ns = min(end_ns, capture.end_ns + 1)
    at_ns = max(start_ns, capture.start_ns)
    while at_ns < end_ns:
        yield at_ns, min(at_ns + _SLICE_NS, end_ns)
        at_ns += _SLICE_NS


def _is_chosen(entry: Drops, chosen: Filter) -> bool:
    ends = {part for name in (entry.node, entry.peer) for part in (name, name.split("/")[0])}
    return (
        all(name is None or name in ends for name in (chosen.node, chosen.peer))
        and chosen.topic in (None, entry.topic)
        and chosen.priority in (None, entry.priority)
    )


def _table(asked: Asked, table: Table) -> Iterator[str]:
    table = replace(table, rows=table.rows[: asked.limit])
    if asked.form is Format.TEXT:
        yield table.text(width=asked.width)
    elif asked.form is Format.JSON:
        yield from (json.dumps(row) for row in table.rows)
    else:
        yield table.csv().rstrip("\n")


def _has_verdicts(capture: Capture) -> bool:
    return any(topic.kind is Kind.VERDICT for topic in capture.topics)


def _verdicts(capture: Capture, start_ns: int, end_ns: int) -> Iterator[VerdictRecord]:
    for record in capture.records({Kind.VERDICT}, start_ns=start_ns, end_ns=end_ns):
        if isinstance(record, VerdictRecord):
            yield record


def _note_all(asked: Asked, notes: Iterable[str]) -> None:
    for text in notes:
        asked.note(text)
