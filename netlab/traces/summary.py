"""The figures of a run as plain JSON values: the parts of ``--json`` that come from the capture."""

from __future__ import annotations

from netlab.medium.verdicts import Verdict
from netlab.traces.model import LinkCounts, Trace
from netlab.traces.reconnects import reconnects
from netlab.traces.reroutes import reroutes
from netlab.traces.streams import StreamReport, stream_reports

_DROPPED = (Verdict.LOST, Verdict.QUEUE_FULL, Verdict.OUTAGE, Verdict.OUT_OF_RANGE, Verdict.COLLISION)
_NOT_TOLD_APART = (Verdict.LOST, Verdict.QUEUE_FULL)


def summary(trace: Trace) -> dict[str, list[dict[str, object]]]:
    """Return ``streams``, ``reconnects`` and ``links``, ``reroutes`` if there are any. Times in scenario s."""
    parts: dict[str, list[dict[str, object]]] = {
        "streams": [_stream(report) for report in stream_reports(trace)],
        "reconnects": [
            {
                "between": list(entry.between),
                "restored_at_s": entry.restored_at_s,
                "first_delivery_s": entry.first_delivery_s,
                "delay_s": entry.delay_s,
            }
            for entry in reconnects(trace)
        ],
        "links": [
            {"from": f"{sender[0]}/{sender[1]}", "to": f"{receiver[0]}/{receiver[1]}", **_link(counts)}
            for (sender, receiver), counts in sorted(trace.links.items())
        ],
    }
    if found := reroutes(trace):
        parts["reroutes"] = [
            {"between": list(entry.between), "cut_at_s": entry.cut_at_s, "delay_s": entry.delay_s} for entry in found
        ]
    return parts


def _stream(report: StreamReport) -> dict[str, object]:
    latency = report.latency
    return {
        "source": report.stream.source,
        "destination": report.stream.destination,
        "topic": report.stream.topic,
        "priority": report.stream.priority,
        "sent": report.sent,
        "delivered": report.delivered,
        "duplicates": report.duplicates,
        "latency_s": {name: getattr(latency, name) if latency else None for name in ("p50", "p90", "p99", "max")},
        "goodput_bps": report.goodput_bps,
        "longest_gap_s": report.longest_gap_s,
    }


def _link(counts: LinkCounts) -> dict[str, object]:
    """Extra copies that the medium made are no frames of the sender: they do not count as frames.

    ``lost`` and ``queue_full`` are None where they are not told apart; ``loss_ratio`` counts both all the same.
    """
    frames = counts.frames - counts.verdicts.get(Verdict.DUPLICATED, 0)
    dropped = sum(counts.verdicts.get(verdict, 0) for verdict in _DROPPED) + counts.lost_or_queue_full
    unknown = _NOT_TOLD_APART if counts.lost_or_queue_full else ()
    return {
        "frames": frames,
        "loss_ratio": dropped / frames if frames else 0.0,
        **{v.name.lower(): None if v in unknown else counts.verdicts.get(v, 0) for v in Verdict},
    }
