"""From a capture to its report: reads, asks, has it drawn, writes one page."""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from netlab.errors import CaptureError, MachineError
from netlab.report import data
from netlab.report.page import Section, page, table
from netlab.report.scene import Scene, load_scene
from netlab.traces.explain import milliseconds, rate
from netlab.traces.load import load_trace
from netlab.traces.model import Trace
from netlab.traces.streams import stream_reports

PAGE = "index.html"
_GRID_COLUMNS = 120
_ROWS_MAX = 40
_PANELS_MAX = 8
_ACTS_MAX = 40


def require_plots() -> None:
    """Say in time that nothing can be drawn here.

    Raises:
        MachineError: matplotlib is not installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise MachineError("plots need matplotlib; install it: pip install 'udp-mesh-lab[report]'")


def write_report(capture: Path, directory: Path, *, topic: str | None = None, base: str | None = None) -> Path:
    """Write the report of a capture and return its page, ``directory``/index.html.

    Args:
        capture: The MCAP file.
        directory: Made if it is not there; a page of the same name is replaced.
        topic: Whose times between messages are shown; None takes ``management`` or what comes nearest to 1 Hz.
        base: To whom nodes are connected or not; None takes ``base`` or the node that received most.

    Raises:
        CaptureError: The file is no capture, or has no such topic or node.
        MachineError: matplotlib is not installed.
        OSError: The page cannot be written.
    """
    require_plots()
    trace, scene = load_trace(capture), load_scene(capture)
    _check(trace, topic, base)
    sections = [
        _streams(trace),
        _arrivals(trace, topic or data.heartbeat_topic(trace)),
        _map(trace, scene, base or _busiest_receiver(trace)),
        _volumes(trace),
        _latencies(trace),
        _waiting(trace),
        *_links(trace, scene),
    ]
    name = scene.metadata.get("name", capture.stem)
    target = directory / PAGE
    directory.mkdir(parents=True, exist_ok=True)
    target.write_text(page(name, _facts(scene, capture), sections), encoding="utf-8")
    return target


def _check(trace: Trace, topic: str | None, base: str | None) -> None:
    topics = sorted({stream.topic for stream in trace.streams})
    nodes = sorted({node for stream in trace.streams for node in (stream.source, stream.destination)})
    for what, name, known in (("topic", topic, topics), ("node", base, nodes)):
        if name is not None and name not in known:
            raise CaptureError(
                f"{trace.path}: no stream has the {what} '{name}'; known are {', '.join(known) or 'none'}"
            )


def _facts(scene: Scene, capture: Path) -> str:
    words = [f"{key} {scene.metadata[key]}" for key in ("engine", "clock", "seed") if scene.metadata.get(key)]
    duration = scene.metadata.get("duration_s")
    words += [f"{float(duration):g} s"] if duration else []
    return ", ".join([*words, capture.name])


def _busiest_receiver(trace: Trace) -> str | None:
    received: Counter[str] = Counter()
    for stream in trace.streams:
        received[stream.destination] += sum(delivery.size_bytes for delivery in trace.delivered.get(stream.index, []))
    return "base" if "base" in received else max(received, key=received.__getitem__, default=None)


def _streams(trace: Trace) -> Section:
    head = ["stream", "priority", "sent", "delivered", "p50", "p99", "max", "goodput", "longest gap"]
    rows = []
    for report in stream_reports(trace):
        latency = report.latency
        times = (latency.p50, latency.p99, latency.max) if latency else (None, None, None)
        counts = [str(report.stream.priority), str(report.sent), str(report.delivered)]
        rows.append([str(report.stream), *counts, *map(milliseconds, times), rate(report.goodput_bps)])
        rows[-1].append(milliseconds(report.longest_gap_s))
    if not rows:
        return Section("Streams", "The capture has no traffic.", None)
    return Section("Streams", "Latency is from the publish call to receipt by the application.", table(head, rows))


def _arrivals(trace: Trace, topic: str | None) -> Section:
    title = "Time between messages" + (f": {topic}" if topic else "")
    found = data.arrivals(trace, topic) if topic else []
    if not found:
        return Section(title, f"No stream has {data.INTERVALS_MIN} receipts of messages in succession.", None)
    from netlab.report import plots

    shown = sorted(found, key=lambda entry: -len(entry.intervals_s))[:_PANELS_MAX]
    within = ", ".join(f"{entry.ratio_within:.0%} {entry.stream}" for entry in shown)
    caption = (
        "Between receipts of messages that follow one another, with the normal distribution of the same mean and "
        "standard deviation (its central 68 % shaded). A gap is where messages in between never came, or the time was "
        "twice the nominal one or more. "
        f"Within 5 % of the nominal interval: {within}."
    )
    return Section(title, caption + _left_out(len(found) - len(shown), "stream"), plots.intermessage_times(shown))


def _map(trace: Trace, scene: Scene, base: str | None) -> Section:
    title = "Map"
    if not scene.paths:
        return Section(title, "The capture holds no poses.", None)
    from netlab.report import plots

    contacts = {node: data.Contact(trace, node, base) for node in scene.paths if base and node != base}
    caption = (
        f"Connected to {base}: what was published up to {data.CONNECTED_WITHIN_S:g} s ago, or two of the longest "
        "publishing intervals, has come through in that time, in either direction. Dots are where nodes were last."
    )
    return Section(title, caption, plots.tunnel_map(scene, contacts))


def _volumes(trace: Trace) -> Section:
    title, found = "Data volume by topic and node", data.volumes(trace)
    if not found:
        return Section(title, "Nothing was delivered.", None)
    from netlab.report import plots

    total = sum(size for by_node in found.values() for size in by_node.values())
    caption = f"Each message once per destination; {total / 1e6:.3g} MB in all, by the node that published it."
    return Section(title, caption, plots.data_volumes(found))


def _latencies(trace: Trace) -> Section:
    title, found = "Latency by priority", data.latencies(trace)
    if not found:
        return Section(title, "Nothing was delivered.", None)
    from netlab.report import plots

    caption = (
        "Every delivered message, the lower number the more urgent. Dotted lines are acts on the lab: outages, flaps, "
        "kills and the like. Long series are thinned out to their extremes."
    )
    return Section(title, caption, plots.latency_by_priority(found, acts_s(trace)))


def acts_s(trace: Trace) -> list[float]:
    """When something was done to the lab; none where it was done so often that lines would hide the rest."""
    times = sorted({round(step.at_s, 2) for step in trace.timeline if step.kind not in ("start", "end")})
    return times if len(times) <= _ACTS_MAX else []


def _waiting(trace: Trace) -> Section:
    title, found = "Queue depths", data.waiting(trace)
    if not found:
        return Section(title, "Nothing was delivered.", None)
    from netlab.report import plots

    caption = "Payload published and not yet delivered, by publishing node; of messages that came through in the end."
    return Section(title, caption, plots.queue_depths(found, acts_s(trace)))


def _links(trace: Trace, scene: Scene) -> list[Section]:
    """Strength where the radio tells it, and the share of frames that arrived."""
    title = "Link quality"
    if not scene.success:
        return [
            Section(
                title,
                "The capture holds no decisions on frames: with the netem engine they are the kernel's own.",
                None,
            )
        ]
    from netlab.report import plots

    pairs = sorted(scene.success, key=lambda pair: -len(scene.success[pair]))[:_ROWS_MAX]
    beyond = _left_out(len(scene.success) - len(pairs), "pair")
    sections = []
    if strengths := _chosen(scene.rssi_dbm, pairs):
        body = plots.link_quality(_grid(trace, strengths), label="signal strength, dBm")
        sections.append(Section("Signal strength", "Mean at the receiver, sender > receiver." + beyond, body))
    shares = _chosen(scene.success, pairs)
    body = plots.link_quality(_grid(trace, shares), label="share of frames that arrived", least=0.0, most=1.0)
    caption = "Of the frames sent in range, sender > receiver; blank where none was sent." + beyond
    return [*sections, Section(title, caption, body)]


def _chosen(
    series: Mapping[str, list[tuple[float, float]]], pairs: Sequence[str]
) -> dict[str, list[tuple[float, float]]]:
    return {pair: series[pair] for pair in sorted(pairs) if pair in series}


def _grid(trace: Trace, series: Mapping[str, list[tuple[float, float]]]) -> data.Grid:
    columns = max(min(_GRID_COLUMNS, round(trace.duration_s)), 1)
    return data.grid(series, start_s=0.0, end_s=max(trace.duration_s, 1.0), columns=columns)


def _left_out(count: int, what: str) -> str:
    return f" {count} more {what}{'s' * (count > 1)} not shown." if count > 0 else ""
