"""The tables of a report: streams, two runs' streams beside each other, expectations with their evidence. Strings."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from netlab.report.expected import Evidence
from netlab.report.page import Html, Pane, Section, table
from netlab.report.run import Run
from netlab.report.words import listed, typeset
from netlab.traces.explain import milliseconds, rate
from netlab.traces.sentences import because
from netlab.traces.story import Story
from netlab.traces.streams import StreamReport

_LEAST_SHARE = 0.005  # of which a cause is worth a line
_BULLET_REACH = 1.25  # a bullet ends at so many times its limit


def expectations(runs: Sequence[Run]) -> Section:
    """Every bound with its figure, how near it is to its limit, and the worst instance, linked to the plot."""
    panes = []
    for run in runs:
        if not run.expected:
            panes.append(Pane(None, "The scenario expects nothing.", run.label))
            continue
        head = ["", "", "expected", "measured", "", "worst instance"]
        rows = [_expectation(entry) for entry in run.expected]
        panes.append(
            Pane(table(head, rows, text_columns=(0, 1), wrapped_columns=(2, 5)) + _stories(run.expected), "", run.label)
        )
    caption = (
        "The bar is the measured figure, the line its bound. Numbers are those of the rings on the plot of latencies."
    )
    return Section("expectations", "Expectations", panes, caption)


def _expectation(entry: Evidence) -> list[str | Html]:
    passed = entry.result.passed
    mark = f'<span class="mark {"good" if passed else "bad"}">{"✓ met" if passed else "✗ not met"}</span>'
    where = f'<a href="#{entry.plot}">plot</a>'
    worst = "–"
    if entry.worst is not None:
        at = f"{entry.worst.at_s:.2f} s: " if entry.worst.at_s is not None else ""
        worst = f"{escape(typeset(at + entry.worst.text))} ({where})"
    number = Html(f'<span class="number">{entry.number}</span>')
    return [number, Html(mark), typeset(entry.result.name), entry.measured, _bullet(entry), Html(worst)]


def _stories(found: Sequence[Evidence]) -> str:
    """What happened around each failure; bounds that failed alike tell it once."""
    alike: dict[str, list[int]] = {}
    for entry in found:
        lines = [line for line in entry.result.explanation.splitlines() if not line.startswith("  capture: ")]
        if lines:
            alike.setdefault("\n".join(lines), []).append(entry.number)
    return "".join(
        f"<details open><summary>Around {listed(numbers)}</summary><pre>{escape(text)}</pre></details>"
        for text, numbers in alike.items()
    )


def _bullet(entry: Evidence) -> Html:
    share = entry.share_of_limit
    if share is None:
        return Html("")
    shown = min(share, _BULLET_REACH) / _BULLET_REACH * 100
    kind = "" if entry.result.passed else " bad"
    words = f"{share:.0%} of the bound"
    bar = f'<i style="width:{shown:.1f}%"></i><b style="left:{100 / _BULLET_REACH:.1f}%"></b>'
    return Html(f'<span class="bullet{kind}" role="img" aria-label="{words}" title="{words}">{bar}</span>')


def causes(story: Story) -> str:
    """Why a message took the time it took: in a sentence, and part by part."""
    rows: list[list[str | Html]] = [
        [
            share.cause.value.replace("_", " "),
            milliseconds(share.duration_s),
            f"{share.ratio:.0%}",
            _share_bar(share.ratio),
        ]
        for share in story.shares
        if share.ratio >= _LEAST_SHARE
    ]
    sentence = f'<p class="because">{escape(typeset(because(story)))}</p>'
    return sentence + (table(["where the time went", "", "", ""], rows, text_columns=(0, 3)) if rows else "")


def _share_bar(ratio: float) -> Html:
    return Html(f'<span class="bar"><i style="width:{100 * ratio:.1f}%"></i></span>')


def comparison(runs: Sequence[Run]) -> Section | None:
    """The streams of two runs, one beside the other; None for one run."""
    return _streams_of_two(runs[0], runs[1]) if len(runs) == 2 else None


def streams(runs: Sequence[Run]) -> Section | None:
    """The figures of every stream of one run."""
    if len(runs) > 1:
        return None
    reports = runs[0].streams
    if not reports:
        return Section("streams", "Streams", [Pane(None, "The capture has no traffic.")])
    head = ["stream", "priority", "sent", "delivered", "lost", "p50", "p99", "max", "goodput", "longest gap"]
    rows = []
    for report in sorted(reports, key=lambda report: report.stream.priority):
        latency = report.latency
        times = (latency.p50, latency.p99, latency.max) if latency else (None, None, None)
        counts = [report.stream.priority, report.sent, report.delivered, report.sent - report.delivered]
        row = [typeset(str(report.stream)), *map(str, counts), *map(_time, times), rate(report.goodput_bps)]
        rows.append([*row, milliseconds(report.longest_gap_s)])
    caption = (
        "Latency is from the publish call to receipt by the application, of delivered messages; lost ones were "
        "refused, given up, or not there one second after the end."
    )
    return Section("streams", "Streams", [Pane(table(head, rows))], caption)


def _streams_of_two(one: Run, two: Run) -> Section:
    both: dict[tuple[str, str, str], list[StreamReport | None]] = {}
    for number, run in enumerate((one, two)):
        for report in run.streams:
            stream = report.stream
            row = both.setdefault((stream.topic, stream.source, stream.destination), [None, None])
            row[number] = row[number] or report
    if not both:
        return Section("streams", "Streams", [Pane(None, "The captures have no traffic.")])
    head = ["stream", "priority", *(f"{what} {run}" for what in ("delivered", "p50", "p99") for run in "AB")]
    head += ["p99 B/A", "goodput A", "goodput B"]
    rows = [_row_of_two(a, b) for a, b in both.values()]
    caption = (
        f"A is {one.label.removeprefix('A: ')}, B is {two.label.removeprefix('B: ')}. B/A compares the 99th "
        "percentiles of delivered messages: ▲ slower, ▼ faster."
    )
    return Section("streams", "Streams", [Pane(table(head, rows))], caption)


def _row_of_two(a: StreamReport | None, b: StreamReport | None) -> list[str | Html]:
    known = a or b
    assert known is not None
    shares = [_share(report) for report in (a, b)]
    p50 = [report.latency.p50 if report and report.latency else None for report in (a, b)]
    p99 = [report.latency.p99 if report and report.latency else None for report in (a, b)]
    goodput = [rate(report.goodput_bps) if report else "–" for report in (a, b)]
    cells = [typeset(str(known.stream)), str(known.stream.priority), *shares, *map(_time, p50), *map(_time, p99)]
    return [*cells, _change(*p99), *goodput]


def _share(report: StreamReport | None) -> str:
    return "–" if report is None or not report.sent else f"{report.delivered / report.sent:.1%}"


def _time(value_s: float | None) -> str:
    return "–" if value_s is None else milliseconds(value_s)


def _change(before_s: float | None, after_s: float | None) -> Html:
    if not before_s or after_s is None:
        return Html("–")
    ratio = after_s / before_s
    if 0.95 <= ratio <= 1.05:
        return Html('<span class="mark">= 1.00×</span>' if round(ratio, 2) == 1 else f"= {ratio:.2f}×")
    kind, sign = ("bad", "▲") if ratio > 1 else ("good", "▼")
    return Html(f'<span class="mark {kind}">{sign} {ratio:.2f}×</span>')
