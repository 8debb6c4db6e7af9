"""``netlab inspect F.mcap``: look into a capture, as text, JSON or CSV."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import click

from netlab.capture.reader import Capture
from netlab.capture.records import Kind
from netlab.capture.view import Filter
from netlab.cli.quantities import SECONDS
from netlab.inspect import questions
from netlab.inspect.choose import HELP as MESSAGE_HELP
from netlab.inspect.names import unknown_names
from netlab.inspect.overview import overview
from netlab.inspect.questions import Asked
from netlab.inspect.table import Format

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
@click.option("--why", metavar="MESSAGE", help=f"The story of one message, and why it was late. {MESSAGE_HELP}.")
@click.option("--conversations", is_flag=True, help="Who talked to whom: frames and bytes by pair and protocol.")
@click.option("--drops", is_flag=True, help="What was refused, dropped and lost, by place and reason.")
@click.option("--queues-at", type=SECONDS, metavar="TIME", help="What the queues held then: 12.5s, or 12.5.")
@click.option("--routes", is_flag=True, help="Which relays carried the data, and when.")
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
    drops: bool,
    queues_at: float | None,
    routes: bool,
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
    chosen = Filter(node, peer, topic, priority, from_s, to_s)
    as_form = Format.JSON if as_json else Format(form)
    asked = Asked(file, chosen, as_form, limit, _width(), note=lambda text: click.echo(f"note: {text}", err=True))
    answer: dict[str, Callable[[], Iterator[str]]] = {}
    if why is not None:
        answer["--why"] = lambda: questions.why(asked, why)
    if conversations:
        answer["--conversations"] = lambda: questions.conversations(asked)
    if drops:
        answer["--drops"] = lambda: questions.drops(asked)
    if queues_at is not None:
        answer["--queues-at"] = lambda: questions.queues_at(asked, queues_at)
    if routes:
        answer["--routes"] = lambda: questions.routes(asked)
    if display is not None and kind in (None, "packets"):
        answer["--display"] = lambda: questions.display(asked, display)
    elif display is not None:
        raise click.UsageError(f"--display chooses packets; it does not go with --kind {kind}")
    elif kind is not None:
        answer["--kind"] = lambda: _list(asked, kind)
    if summary_only:
        answer["--summary"] = lambda: overview(asked)
    if len(answer) > 1:
        raise click.UsageError(f"one question at a time: {' or '.join(answer)}")
    if from_s is not None and to_s is not None and from_s >= to_s:
        raise click.UsageError(f"there is no time from {from_s:g} s to before {to_s:g} s")
    with Capture.open(file) as capture:
        for remark in unknown_names(capture, chosen):
            asked.note(remark)
    for line in next(iter(answer.values()), lambda: _without_question(asked))():
        click.echo(line)


def _without_question(asked: Asked) -> Iterator[str]:
    if asked.chosen == Filter():
        return overview(asked)
    return _list(asked, "messages" if asked.chosen.chooses_messages else "packets")


def _list(asked: Asked, kind: str) -> Iterator[str]:
    return questions.messages(asked) if kind == "messages" else questions.records(asked, _KINDS[kind])


def _width() -> int:
    """Columns of the terminal; 100 where there is none."""
    return max(60, min(shutil.get_terminal_size((100, 24)).columns, 120))
