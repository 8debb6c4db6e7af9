"""What a person needs to see beside a failed expectation: what happened around it, and where the capture is."""

from __future__ import annotations

from netlab.traces.model import NS_PER_S, Trace

_BEFORE_S = 2.0
_AFTER_S = 2.0
_MOST_LINES = 14


def around(trace: Trace, t_ns: int, what: str) -> str:
    """The timeline around a moment, one line per entry in scenario time, ``what`` marked, and the capture's path."""
    start, end = t_ns - round(_BEFORE_S * NS_PER_S), t_ns + round(_AFTER_S * NS_PER_S)
    lines = [(step.t_ns, f"timeline: {step.label or step.kind}") for step in trace.timeline]
    lines += [(remark.t_ns, f"{remark.node}: {remark.text}") for remark in trace.remarks]
    lines += [
        (entry.t_ns, f"{stream.source}: publish {stream.topic} #{entry.seq} refused ({entry.reason})")
        for stream in trace.streams
        for entry in trace.published.get(stream.index, [])
        if not entry.accepted
    ]
    near = sorted(line for line in lines if start <= line[0] <= end)
    near = _thinned(near, t_ns)
    shown = sorted([*((at, f"  {text}") for at, text in near), (t_ns, f"> {what}")])
    earlier = [step for step in trace.timeline if step.t_ns < start]
    if earlier:
        shown.insert(0, (earlier[-1].t_ns, f"  timeline: {earlier[-1].label or earlier[-1].kind}"))
    text = "\n".join(f"  {trace.seconds(at):9.3f} s {line}" for at, line in shown)
    return f"{text}\n  capture: {trace.path}"


def _thinned(lines: list[tuple[int, str]], t_ns: int) -> list[tuple[int, str]]:
    """The lines nearest to the moment."""
    return sorted(sorted(lines, key=lambda line: abs(line[0] - t_ns))[:_MOST_LINES])


def milliseconds(value_s: float | None) -> str:
    """A time for a person."""
    return "none" if value_s is None else f"{value_s * 1000:.1f} ms" if value_s < 10 else f"{value_s:.2f} s"


def rate(value_bps: float) -> str:
    """A rate for a person."""
    for unit, size in (("Gbit/s", 1e9), ("Mbit/s", 1e6), ("kbit/s", 1e3)):
        if value_bps >= size:
            return f"{value_bps / size:.2f} {unit}"
    return f"{value_bps:.0f} bit/s"
