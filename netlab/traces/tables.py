"""The summary of a trace as text for a terminal of 100 columns."""

from __future__ import annotations

from collections.abc import Sequence

from netlab.medium.verdicts import Verdict
from netlab.traces.explain import milliseconds, rate
from netlab.traces.inversions import inversions
from netlab.traces.model import Trace
from netlab.traces.reconnects import reconnects
from netlab.traces.reroutes import reroutes
from netlab.traces.retransmissions import retransmissions
from netlab.traces.streams import stream_reports

_MOST_LINKS = 24


def summary_text(trace: Trace) -> str:
    """Streams, senders, reconnects, reroutes, links and the timeline; parts with nothing to say are left out."""
    parts = [
        _section("streams", _streams(trace)),
        _section("senders", _senders(trace)),
        _section("reconnects", _reconnects(trace)),
        _section("reroutes", _reroutes(trace)),
        _section("links", _links(trace)),
        _section("timeline", _timeline(trace)),
    ]
    return "\n\n".join(part for part in parts if part)


def columns(rows: Sequence[Sequence[str]], *, left: int = 1) -> list[str]:
    """Lay rows out in columns; the first ``left`` columns lean left, the others right. The first row is the head."""
    widths = [max(len(row[index]) for row in rows) for index in range(len(rows[0]))]
    return [
        "  ".join(
            cell.ljust(width) if index < left else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def _section(title: str, lines: list[str]) -> str:
    return "\n".join([title, *(f"  {line}" for line in lines)]) if lines else ""


def _streams(trace: Trace) -> list[str]:
    rows = [["stream", "pri", "sent", "delivered", "dup", "p50", "p99", "max", "goodput", "gap"]]
    for report in stream_reports(trace):
        latency = report.latency
        times = (latency.p50, latency.p99, latency.max) if latency else (None, None, None)
        rows.append(
            [
                str(report.stream),
                str(report.stream.priority),
                str(report.sent),
                f"{report.delivered} {_percent(report.delivered, report.sent)}",
                str(report.duplicates),
                *map(milliseconds, times),
                rate(report.goodput_bps),
                milliseconds(report.longest_gap_s),
            ]
        )
    return columns(rows) if len(rows) > 1 else []


def _senders(trace: Trace) -> list[str]:
    rows = [["node", "fragments", "retransmitted", "priority inversions"]]
    for node, fragments in sorted(trace.fragments.items()):
        again = len(retransmissions(trace, node))
        rows.append([node, str(len(fragments)), f"{again} {_percent(again, len(fragments))}", _inverted(trace, node)])
    return columns(rows) if len(rows) > 1 else []


def _inverted(trace: Trace, node: str) -> str:
    return str(len(inversions(trace, node)))


def _reconnects(trace: Trace) -> list[str]:
    rows = [["between", "restored", "first delivery", "delay"]]
    for entry in reconnects(trace):
        first = "none" if entry.first_delivery_s is None else f"{entry.first_delivery_s:.3f} s"
        delay = milliseconds(entry.delay_s)
        rows.append(["-".join(entry.between), f"{entry.restored_at_s:.3f} s", first, delay])
    return columns(rows) if len(rows) > 1 else []


def _reroutes(trace: Trace) -> list[str]:
    rows = [["between", "cut", "delay"]]
    for entry in reroutes(trace):
        rows.append(["-".join(entry.between), f"{entry.cut_at_s:.3f} s", milliseconds(entry.delay_s)])
    return columns(rows) if len(rows) > 1 else []


def _links(trace: Trace) -> list[str]:
    rows = [["from", "to", "frames", "lost", "queue full", "outage", "out of range", "collision", "other"]]
    for (sender, receiver), counts in sorted(trace.links.items())[:_MOST_LINKS]:
        count = counts.verdicts.get
        other = count(Verdict.CORRUPTED, 0) + count(Verdict.DUPLICATED, 0) + count(Verdict.REORDERED, 0)
        lost = [str(count(verdict, 0)) for verdict in (Verdict.LOST, Verdict.QUEUE_FULL)]
        if counts.lost_or_queue_full:  # not told apart
            lost = [f"<= {counts.lost_or_queue_full}"] * 2
        frames = counts.frames - count(Verdict.DUPLICATED, 0)
        numbers = [frames, *lost, count(Verdict.OUTAGE, 0), count(Verdict.OUT_OF_RANGE, 0)]
        numbers += [count(Verdict.COLLISION, 0), other]
        rows.append(["/".join(sender), "/".join(receiver), *map(str, numbers)])
    lines = columns(rows, left=2) if len(rows) > 1 else []
    hidden = len(trace.links) - _MOST_LINKS
    return [*lines, f"... and {hidden} more (--json has all)"] if hidden > 0 else lines


def _timeline(trace: Trace) -> list[str]:
    return [f"{trace.seconds(step.t_ns):9.3f} s  {step.label or step.kind}" for step in trace.timeline]


def _percent(part: int, whole: int) -> str:
    return f"({100 * part / whole:.0f} %)" if whole else ""
