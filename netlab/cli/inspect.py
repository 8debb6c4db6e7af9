"""``netlab inspect F.mcap``: look into a capture, as text, JSON or CSV."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import click

from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord, VerdictRecord
from netlab.capture.view import Filter, View
from netlab.cli.quantities import SECONDS
from netlab.inspect import answers
from netlab.inspect.choose import HELP as MESSAGE_HELP
from netlab.inspect.choose import choose_message, fits, in_time
from netlab.inspect.display import matching
from netlab.inspect.records import record_lines
from netlab.inspect.story_text import story_json, story_table, story_text
from netlab.inspect.table import Format, Table, csv_lines
from netlab.traces.conversations import Conversations
from netlab.traces.drops import drops
from netlab.traces.evidence import gather_all
from netlab.traces.load import load_trace, read_trace
from netlab.traces.messages import MessageLife, message_lives
from netlab.traces.model import Trace
from netlab.traces.queues_at import queues_at
from netlab.traces.routes import routes
from netlab.traces.summary import summary
from netlab.traces.tables import columns, summary_text
from netlab.traces.tell import tell

_KINDS = {
    "packets": {Kind.PACKET},
    "verdicts": {Kind.VERDICT},
    "events": {Kind.EVENT, Kind.PUBLISHED, Kind.RECEIVED},
    "timeline": {Kind.TIMELINE},
    "links": {Kind.LINKS},
    "poses": {Kind.MAP, Kind.POSES},
    "logs": {Kind.LOG},
}
_IN_LINKS_NS = 10_000_000_000  # nothing stays longer in a link


@dataclass(frozen=True, slots=True)
class _Request:
    """What was asked for: of which file, about what, in which form."""

    file: Path
    chosen: Filter
    form: Format
    limit: int | None

    @property
    def start_ns(self) -> Callable[[Trace], int]:
        """The begin of the chosen time."""
        from_s = self.chosen.from_s
        return lambda trace: 0 if from_s is None else max(0, trace.t0_ns + round(from_s * 1e9))

    @property
    def end_ns(self) -> Callable[[Trace], int]:
        """The end of the chosen time."""
        to_s = self.chosen.to_s
        return lambda trace: 1 << 62 if to_s is None else max(0, trace.t0_ns + round(to_s * 1e9))


@click.command("inspect")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--why", metavar="MESSAGE", help=f"The story of one message, and why it was late. {MESSAGE_HELP}.")
@click.option("--conversations", is_flag=True, help="Who talked to whom: frames and bytes by pair and protocol.")
@click.option("--drops", "ask_drops", is_flag=True, help="What was refused, dropped and lost, by place and reason.")
@click.option("--queues-at", type=SECONDS, metavar="TIME", help="What the queues held then: 12.5s, or 12.5.")
@click.option("--routes", "ask_routes", is_flag=True, help="Which relays carried the data, and when.")
@click.option("--kind", type=click.Choice([*_KINDS, "messages"]), help="List these records instead of the summary.")
@click.option("--display", metavar="EXPR", help="List the packets that match this Wireshark display filter (tshark).")
@click.option("--node", help="Only what this node saw, sent or received.")
@click.option("--peer", help="Only what went between the node and this other one.")
@click.option("--topic", help="Only messages of this topic.")
@click.option("--priority", type=int, help="Only messages of this priority.")
@click.option("--from", "--from-s", "from_s", type=SECONDS, metavar="TIME", help="From this scenario time on: 4.5s.")
@click.option("--to", "--to-s", "to_s", type=SECONDS, metavar="TIME", help="Up to before this scenario time.")
@click.option("--summary", "summary_only", is_flag=True, help="The summary of the file (the default).")
@click.option(
    "--format",
    "form",
    type=click.Choice([form.value for form in Format]),
    default=Format.TEXT.value,
    help="text, json or csv.",
)
@click.option("--json", "as_json", is_flag=True, help="As --format json: one object, or one per record and line.")
@click.option("--limit", type=click.IntRange(min=1), help="At most so many records or rows.")
def inspect(
    file: Path,
    why: str | None,
    conversations: bool,
    ask_drops: bool,
    queues_at: float | None,
    ask_routes: bool,
    kind: str | None,
    display: str | None,
    node: str | None,
    peer: str | None,
    topic: str | None,
    priority: int | None,
    from_s: float | None,
    to_s: float | None,
    summary_only: bool,
    form: str,
    as_json: bool,
    limit: int | None,
) -> None:
    """Show what the capture FILE holds: a summary, the answer to one question, or its records in the order of time.

    Times are scenario seconds: 0 is when every process was ready.

    \b
      netlab inspect run.mcap --why slowest --topic telemetry
      netlab inspect run.mcap --why 'telemetry#20'
      netlab inspect run.mcap --queues-at 12.5s
      netlab inspect run.mcap --display 'frame.len > 1000' --node robot1
    """
    asked = _Request(
        file, Filter(node, peer, topic, priority, from_s, to_s), Format.JSON if as_json else Format(form), limit
    )
    questions: dict[str, Callable[[], None]] = {}
    if why is not None:
        questions["--why"] = lambda: _why(asked, why)
    if conversations:
        questions["--conversations"] = lambda: _conversations(asked)
    if ask_drops:
        questions["--drops"] = lambda: _drops(asked)
    if queues_at is not None:
        questions["--queues-at"] = lambda: _queues(asked, queues_at)
    if ask_routes:
        questions["--routes"] = lambda: _routes(asked)
    if display is not None:
        questions["--display"] = lambda: _display(asked, display, kind)
    elif kind is not None:
        questions["--kind"] = lambda: _records(asked, kind)
    if summary_only:
        questions["--summary"] = lambda: _summary(asked)
    if len(questions) > 1:
        raise click.UsageError(f"one question at a time: {' or '.join(questions)}")
    if questions:
        next(iter(questions.values()))()
    elif asked.chosen == Filter():
        _summary(asked)
    else:
        _records(asked, "messages" if asked.chosen.chooses_messages else "packets")


def _summary(asked: _Request) -> None:
    with Capture.open(asked.file) as capture:
        metadata, counts = capture.metadata, capture.counts()
        notes, first_ns, end_ns = capture.notes, capture.t0_ns, capture.end_ns
    trace = load_trace(asked.file)
    told = summary(trace)
    if asked.form is Format.JSON:
        head = {"capture": str(asked.file), "metadata": metadata, "messages": dict(sorted(counts.items()))}
        click.echo(json.dumps({**head, "notes": notes, **told}))
        return
    _notes(notes)
    if asked.form is Format.CSV:
        rows = [_flat(row) for row in told["streams"]]
        click.echo("".join(csv_lines(list(rows[0]), rows)) if rows else "", nl=False)
        return
    words = {key: metadata.get(key) for key in ("engine", "clock", "seed", "duration_s")}
    line = "  ".join(f"{key} {value}" for key, value in words.items() if value)
    click.echo(f"{metadata.get('name', asked.file.name)}  {line}".rstrip())
    click.echo(f"{asked.file}: {asked.file.stat().st_size / 1e6:.1f} MB, {sum(counts.values())} messages, ", nl=False)
    click.echo(f"up to {(end_ns - first_ns) / 1e9:.3f} s" if counts else "empty")
    if counts:
        click.echo("\ntopics")
        for row in columns([[name, str(count)] for name, count in sorted(counts.items())]):
            click.echo(f"  {row}")
    if text := summary_text(trace):
        click.echo(f"\n{text}")


def _flat(row: dict[str, object]) -> dict[str, object]:
    """Give values inside values columns of their own: ``latency_s`` of ``p50`` becomes ``latency_p50_s``."""
    flat: dict[str, object] = {}
    for key, value in row.items():
        if isinstance(value, dict):
            flat |= {f"{key.removesuffix('_s')}_{name}_s": inner for name, inner in value.items()}
        else:
            flat[key] = value
    return flat


def _why(asked: _Request, text: str) -> None:
    with Capture.open(asked.file) as capture:
        trace = read_trace(capture, with_packets=False)
        stream, published = choose_message(trace, text, asked.chosen)
        story = tell(capture, trace, stream, published)
        _notes(capture.notes)
    if asked.form is Format.JSON:
        click.echo(json.dumps(story_json(story)))
    elif asked.form is Format.CSV:
        click.echo(story_table(story).csv(), nl=False)
    else:
        click.echo(story_text(story, width=_width()))


def _conversations(asked: _Request) -> None:
    with Capture.open(asked.file) as capture:
        trace = read_trace(capture, with_packets=False)
        found = Conversations(trace)
        start_ns, end_ns = asked.start_ns(trace), asked.end_ns(trace)
        for record in capture.records({Kind.PACKET}, start_ns=start_ns, end_ns=end_ns):
            if isinstance(record, PacketRecord):
                found.packet(record)
        _notes(capture.notes)
    ends = {asked.chosen.node, asked.chosen.peer} - {None}
    _print(asked, answers.conversations_table(trace, [t for t in found.result() if ends <= {t.a, t.b}]))


def _drops(asked: _Request) -> None:
    with Capture.open(asked.file) as capture:
        has_verdicts = any(topic.kind is Kind.VERDICT for topic in capture.topics)
        trace = read_trace(capture, with_packets=not has_verdicts)
        verdicts = _verdicts(capture, asked.start_ns(trace), asked.end_ns(trace)) if has_verdicts else iter(())
        found = drops(trace, verdicts, chosen=lambda t_ns: in_time(trace, t_ns, asked.chosen))
        _notes(capture.notes)
    chosen = asked.chosen
    kept = [
        entry
        for entry in found
        if all(name is None or name in _ends(entry.node, entry.peer) for name in (chosen.node, chosen.peer))
        and chosen.topic in (None, entry.topic)
        and chosen.priority in (None, entry.priority)
    ]
    _print(asked, answers.drops_table(trace, kept, is_for_people=asked.form is Format.TEXT))


def _queues(asked: _Request, at_s: float) -> None:
    with Capture.open(asked.file) as capture:
        trace = read_trace(capture, with_packets=False)
        t_ns = trace.t0_ns + round(at_s * 1e9)
        if not trace.t0_ns <= t_ns <= capture.end_ns:
            raise click.UsageError(f"--queues-at {at_s:g}s: the capture ends at {trace.seconds(capture.end_ns):.3f} s")
        has_verdicts = any(topic.kind is Kind.VERDICT for topic in capture.topics)
        found = queues_at(trace, t_ns, _verdicts(capture, max(0, t_ns - _IN_LINKS_NS), t_ns + 1))
        _notes(capture.notes)
    tables = answers.queues_tables(trace, found, has_verdicts=has_verdicts)
    if asked.form is Format.TEXT:
        click.echo("\n\n".join(table.text(width=_width()) for table in tables))
    elif asked.form is Format.JSON:
        names = ("waiting", "in_links", "windows")
        click.echo(
            json.dumps({"kind": "queues", "t_s": at_s, **{n: list(t.rows) for n, t in zip(names, tables, strict=True)}})
        )
    else:
        click.echo(tables[0].csv(), nl=False)


def _routes(asked: _Request) -> None:
    with Capture.open(asked.file) as capture:
        trace = read_trace(capture, with_packets=False)
        streams = [stream for stream in trace.streams if fits(stream, asked.chosen)]
        sources = {stream.source for stream in streams}
        start_ns, end_ns = asked.start_ns(trace), asked.end_ns(trace)
        evidence = gather_all(capture, sources, start_ns=start_ns, end_ns=end_ns, with_verdicts=False)
        found = [
            route
            for source in sorted(sources)
            for route in routes(trace, evidence[source], {s.destination for s in streams if s.source == source})
        ]
        _notes(capture.notes)
    _print(asked, answers.routes_table(trace, found))


def _display(asked: _Request, expression: str, kind: str | None) -> None:
    if kind not in (None, "packets"):
        raise click.UsageError(f"--display chooses packets; it does not go with --kind {kind}")
    with Capture.open(asked.file) as capture, matching(capture, expression) as found:
        view = View(capture, asked.chosen)
        chosen = (record for record in found if view.wants(record))
        _lines(record_lines(view, islice(chosen, asked.limit), Kind.PACKET, asked.form))
        _notes(capture.notes)


def _records(asked: _Request, kind: str) -> None:
    if kind == "messages":
        _messages(asked)
        return
    with Capture.open(asked.file) as capture:
        view = View(capture, asked.chosen)
        records = islice(view.records(_KINDS[kind]), asked.limit)
        _lines(record_lines(view, records, min(_KINDS[kind]), asked.form))
        _notes(capture.notes)


def _messages(asked: _Request) -> None:
    trace = load_trace(asked.file)
    lives = islice((life for life in message_lives(trace) if _chosen(trace, life, asked.chosen)), asked.limit)
    if asked.form is Format.TEXT:
        _lines(answers.message_text(trace, life) for life in lives)
    elif asked.form is Format.JSON:
        _lines(json.dumps(answers.message_row(trace, life)) for life in lives)
    else:
        rows = (answers.message_row(trace, life) for life in lives)
        _lines(line.rstrip("\n") for line in csv_lines(answers.MESSAGE_KEYS, rows))
    _notes(trace.notes)


def _chosen(trace: Trace, life: MessageLife, chosen: Filter) -> bool:
    return fits(life.stream, chosen) and in_time(trace, life.published.t_ns, chosen)


def _verdicts(capture: Capture, start_ns: int, end_ns: int) -> Iterator[VerdictRecord]:
    for record in capture.records({Kind.VERDICT}, start_ns=start_ns, end_ns=end_ns):
        if isinstance(record, VerdictRecord):
            yield record


def _ends(*names: str) -> set[str]:
    """Nodes, also of names like ``node/interface``."""
    return {part for name in names for part in (name, name.split("/")[0])}


def _print(asked: _Request, table: Table) -> None:
    if asked.limit is not None:
        table = Table(table.title, table.columns, table.rows[: asked.limit], table.empty)
    if asked.form is Format.TEXT:
        click.echo(table.text(width=_width()))
    elif asked.form is Format.JSON:
        _lines(json.dumps(row) for row in table.rows)
    else:
        click.echo(table.csv(), nl=False)


def _lines(lines: Iterable[str]) -> None:
    for line in lines:
        click.echo(line)


def _width() -> int:
    """Columns of the terminal; 100 where there is none."""
    return max(60, min(shutil.get_terminal_size((100, 24)).columns, 120))


def _notes(notes: list[str]) -> None:
    for note in notes:
        click.echo(f"note: {note}", err=True)
