"""``netlab inspect F.mcap``: look into a capture, as text or as JSON."""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path

import click

from netlab.capture.reader import Capture
from netlab.capture.records import Kind
from netlab.capture.view import Filter, View
from netlab.traces.explain import milliseconds
from netlab.traces.load import load_trace
from netlab.traces.messages import MessageLife, message_lives
from netlab.traces.summary import summary
from netlab.traces.tables import columns, summary_text

_KINDS = {
    "packets": {Kind.PACKET},
    "verdicts": {Kind.VERDICT},
    "events": {Kind.EVENT, Kind.PUBLISHED, Kind.RECEIVED},
    "timeline": {Kind.TIMELINE},
    "links": {Kind.LINKS},
    "poses": {Kind.MAP, Kind.POSES},
    "logs": {Kind.LOG},
}


@click.command("inspect")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--kind", type=click.Choice([*_KINDS, "messages"]), help="List these records instead of the summary.")
@click.option("--node", help="Only what this node saw, sent or received.")
@click.option("--peer", help="Only what went between the node and this other one.")
@click.option("--topic", help="Only messages of this topic.")
@click.option("--priority", type=int, help="Only messages of this priority.")
@click.option("--from-s", type=float, help="From this scenario time on, in seconds.")
@click.option("--to-s", type=float, help="Up to before this scenario time.")
@click.option("--summary", "summary_only", is_flag=True, help="The summary of the file (the default without --kind).")
@click.option("--json", "as_json", is_flag=True, help="The summary as one object, records as one object per line.")
@click.option("--limit", type=click.IntRange(min=1), help="At most so many records.")
def inspect(
    file: Path,
    kind: str | None,
    node: str | None,
    peer: str | None,
    topic: str | None,
    priority: int | None,
    from_s: float | None,
    to_s: float | None,
    summary_only: bool,
    as_json: bool,
    limit: int | None,
) -> None:
    """Show what the capture FILE holds: a summary, or its records in the order of time.

    Times are scenario seconds: 0 is when every process was ready.
    """
    chosen = Filter(node, peer, topic, priority, from_s, to_s)
    if kind is None and not summary_only and chosen != Filter():
        kind = "messages" if chosen.chooses_messages else "packets"
    if kind is None or summary_only:
        _print_summary(file, as_json=as_json)
    elif kind == "messages":
        _print_messages(file, chosen, as_json=as_json, limit=limit)
    else:
        _print_records(file, kind, chosen, as_json=as_json, limit=limit)


def _print_summary(file: Path, *, as_json: bool) -> None:
    with Capture.open(file) as capture:
        metadata, counts = capture.metadata, capture.counts()
        notes, first_ns, end_ns = capture.notes, capture.t0_ns, capture.end_ns
    trace = load_trace(file)
    if as_json:
        head = {"capture": str(file), "metadata": metadata, "messages": dict(sorted(counts.items())), "notes": notes}
        click.echo(json.dumps(head | summary(trace)))
        return
    _print_notes(notes)
    words = {key: metadata.get(key) for key in ("engine", "clock", "seed", "duration_s")}
    told = "  ".join(f"{key} {value}" for key, value in words.items() if value)
    click.echo(f"{metadata.get('name', file.name)}  {told}".rstrip())
    click.echo(f"{file}: {file.stat().st_size / 1e6:.1f} MB, {sum(counts.values())} messages, ", nl=False)
    click.echo(f"up to {(end_ns - first_ns) / 1e9:.3f} s" if counts else "empty")
    if counts:
        click.echo("\ntopics")
        for line in columns([[name, str(count)] for name, count in sorted(counts.items())]):
            click.echo(f"  {line}")
    if text := summary_text(trace):
        click.echo(f"\n{text}")


def _print_records(file: Path, kind: str, chosen: Filter, *, as_json: bool, limit: int | None) -> None:
    with Capture.open(file) as capture:
        view = View(capture, chosen)
        for record in islice(view.records(_KINDS[kind]), limit):
            click.echo(json.dumps(view.json(record)) if as_json else view.text(record))
        _print_notes(capture.notes)


def _print_messages(file: Path, chosen: Filter, *, as_json: bool, limit: int | None) -> None:
    trace = load_trace(file)
    lives = (life for life in message_lives(trace) if _chosen(life, chosen, trace.seconds(life.published.t_ns)))
    for life in islice(lives, limit):
        at_s = trace.seconds(life.published.t_ns)
        click.echo(json.dumps(_life_json(life, at_s)) if as_json else _life_text(life, at_s))
    _print_notes(trace.notes)


def _chosen(life: MessageLife, chosen: Filter, at_s: float) -> bool:
    ends = {life.stream.source, life.stream.destination}
    return (
        all(name is None or name in ends for name in (chosen.node, chosen.peer))
        and chosen.topic in (None, life.stream.topic)
        and chosen.priority in (None, life.stream.priority)
        and (chosen.from_s is None or at_s >= chosen.from_s)
        and (chosen.to_s is None or at_s < chosen.to_s)
    )


def _life_text(life: MessageLife, at_s: float) -> str:
    if not life.published.accepted:
        fate = f"refused ({life.published.reason})"
    elif life.delivery is None:
        fate = "not delivered"
    else:
        fate = f"delivered after {milliseconds(life.delivery.latency_s)}"
        fate += f", {life.receipts} times" if life.receipts > 1 else ""
    again = f" +{life.retransmissions} again" if life.retransmissions else ""
    name = f"{life.stream} #{life.published.seq}"
    sent = f"{life.fragments} fragments{again}"
    return f"{at_s:12.6f}  p{life.stream.priority:<3} {name:<36} {life.published.size_bytes:>8} B  {sent:<16} {fate}"


def _life_json(life: MessageLife, at_s: float) -> dict[str, object]:
    return {
        "t_s": at_s,
        "kind": "message",
        "source": life.stream.source,
        "destination": life.stream.destination,
        "topic": life.stream.topic,
        "priority": life.stream.priority,
        "seq": life.published.seq,
        "size_bytes": life.published.size_bytes,
        "accepted": life.published.accepted,
        "reason": life.published.reason,
        "latency_s": life.delivery.latency_s if life.delivery else None,
        "receipts": life.receipts,
        "fragments": life.fragments,
        "retransmissions": life.retransmissions,
        "copies": life.copies,
    }


def _print_notes(notes: list[str]) -> None:
    for note in notes:
        click.echo(f"note: {note}", err=True)
