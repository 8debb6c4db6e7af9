"""From captures to their report: reads, asks, has it drawn, writes one page."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

from netlab.capture.reader import OnRead
from netlab.errors import MachineError
from netlab.report import sections, tables
from netlab.report.cdf import latency_cdfs
from netlab.report.page import Card, Html, Section, page
from netlab.report.run import OnStep, Run, Wishes, load_run
from netlab.traces.explain import milliseconds

PAGE = "index.html"
_SECTIONS: tuple[Callable[[Sequence[Run]], Section | None], ...] = (
    tables.expectations,
    tables.comparison,
    sections.distributions,
    sections.latencies,
    sections.message,
    sections.reconnects,
    sections.tunnel_map,
    sections.arrivals,
    sections.volumes,
    sections.waiting,
    sections.strengths,
    sections.link_quality,
    tables.streams,
)
#: How many things :func:`write_report` tells of, for one capture and for each further one.
STEPS = 4 + len(_SECTIONS)
STEPS_MORE = 4


def require_plots() -> None:
    """Say in time that nothing can be drawn here.

    Raises:
        MachineError: matplotlib is not installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise MachineError("plots need matplotlib; install it: pip install 'udp-mesh-lab[report]'")


def write_report(
    capture: Path,
    directory: Path,
    *,
    topic: str | None = None,
    base: str | None = None,
    message: str | None = None,
    other: Path | None = None,
    on_step: OnStep = lambda what: None,
    on_read: OnRead = lambda done, total: None,
) -> Path:
    """Write the report of a capture, or of two side by side, and return its page, ``directory``/index.html.

    Args:
        capture: The MCAP file.
        directory: Made if it is not there; a page of the same name is replaced.
        topic: Whose times between messages are shown; None takes ``management`` or what comes nearest to 1 Hz.
        base: To whom nodes are connected or not; None takes ``base`` or the node that received most.
        message: Whose way is shown, as ``TOPIC#NUMBER``; None takes the slowest of the most urgent priority.
        other: A second capture to compare with.
        on_step: Told what is being done, ``STEPS`` times and ``STEPS_MORE`` times for a second capture.
        on_read: Told how many of how many parts of a file have been read, at the present step.

    Raises:
        CaptureError: A file is no capture, or has no such topic, node or message.
        MachineError: matplotlib is not installed.
        OSError: The page cannot be written.
    """
    require_plots()
    wishes = Wishes(topic, base, message)
    if other is None:
        runs = [load_run(capture, wishes, on_step=on_step, on_read=on_read)]
    else:
        labels = _labels(capture, other)
        runs = [load_run(path, wishes, label=label, on_step=on_step, on_read=on_read) for path, label in labels]
    drawn = []
    for draw in _SECTIONS:
        on_step(f"drawing {(draw.__name__).replace('_', ' ')}")
        drawn.append(draw(runs))
    shown = [section for section in drawn if section is not None]
    title = " and ".join(dict.fromkeys(run.name for run in runs))
    target = directory / PAGE
    directory.mkdir(parents=True, exist_ok=True)
    text = page(title, _facts(runs), _cards(runs), shown, is_pair=len(runs) > 1)
    target.write_text(text, encoding="utf-8")
    return target


def _labels(capture: Path, other: Path) -> list[tuple[Path, str]]:
    names = [capture.stem, other.stem]
    if names[0] == names[1]:
        names = [str(capture), str(other)]
    return [(capture, f"A: {names[0]}"), (other, f"B: {names[1]}")]


def _facts(runs: Sequence[Run]) -> Html:
    return Html("".join(f'<p class="facts">{_facts_of(run)}</p>' for run in runs))


def _facts_of(run: Run) -> str:
    metadata = run.scene.metadata
    words = [f"{key} <b>{escape(metadata[key])}</b>" for key in ("engine", "clock", "seed") if metadata.get(key)]
    duration = metadata.get("duration_s")
    words += [f"<b>{float(duration):g} s</b>"] if duration else []
    label = f"<b>{escape(run.label)}</b> · " if run.label else ""
    missing = [f"missing from the capture: {count} of {topic}" for topic, count in run.scene.losses.items()]
    notes = "".join(f"<br>{escape(note)}" for note in [*run.trace.notes, *missing])
    return label + " · ".join([*words, escape(run.path.name)]) + notes


def _cards(runs: Sequence[Run]) -> list[Card]:
    """The few figures that everybody looks for first; of two runs, one behind the other."""
    cards = []
    met = [(sum(entry.result.passed for entry in run.expected), len(run.expected)) for run in runs]
    if any(total for _, total in met):
        is_good = all(good == total for good, total in met)
        cards.append(Card("expectations met", _both(f"{good} of {total}" for good, total in met), is_good))
    shares = [_delivered(run) for run in runs]
    cards.append(Card("messages delivered", _both(shares)))
    urgent = [_urgent_p99(run) for run in runs]
    cards.append(Card(f"latency p99, {_urgent_name(runs)}", _both(urgent)))
    if any(run.falls for run in runs):
        cards.append(Card("slowest reconnect", _both(map(_slowest_reconnect, runs))))
    cards.append(Card("fragments sent again", _both(map(_sent_again, runs))))
    return cards


def _both(values: Sequence[str] | map[str] | object) -> str:
    return " → ".join(values)  # type: ignore[arg-type]


def _delivered(run: Run) -> str:
    sent, delivered = (sum(getattr(report, name) for report in run.streams) for name in ("sent", "delivered"))
    return f"{delivered / sent:.1%}" if sent else "none"


def _most_urgent(run: Run) -> int | None:
    return min((report.stream.priority for report in run.streams if report.delivered), default=None)


def _urgent_name(runs: Sequence[Run]) -> str:
    known = {priority for run in runs if (priority := _most_urgent(run)) is not None}
    return f"priority {known.pop()}" if len(known) == 1 else "most urgent"


def _urgent_p99(run: Run) -> str:
    priority = _most_urgent(run)
    if priority is None:
        return "none"
    values = latency_cdfs(run.trace)[priority].latencies_s
    return milliseconds(values[max(-(-99 * len(values) // 100), 1) - 1])


def _slowest_reconnect(run: Run) -> str:
    if not run.falls:
        return "none"
    delays = [fall.delivery_s for fall in run.falls]
    return "never" if None in delays else milliseconds(max(delay for delay in delays if delay is not None))


def _sent_again(run: Run) -> str:
    from netlab.traces.retransmissions import retransmissions

    return str(sum(len(retransmissions(run.trace, node)) for node in run.trace.fragments))
