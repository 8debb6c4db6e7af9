"""The sections of a report: what each is called, what its caption says, which plot it asks for. One pane per run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from netlab.report import data, tables
from netlab.report.cdf import latency_cdfs
from netlab.report.lane import Cargo, Lane
from netlab.report.page import Pane, Section, figure
from netlab.report.run import Run
from netlab.report.words import counted, typeset
from netlab.traces.explain import milliseconds

_GRID_COLUMNS = 120
_ROWS_MAX = 40
_PANELS_MAX = 8
_TIME_PLOT = (
    "Dotted lines are acts on the lab: outages, flaps, kills and the like; hatched is where the two nodes of a "
    "stream had no link of their own. Long series are thinned out to their extremes."
)


def panes(runs: Sequence[Run], bodies: Iterable[str], captions: Iterable[str]) -> list[Pane]:
    """One pane per run: its plot with its caption, or, where the plot is empty, the caption that says why."""
    return [
        Pane(figure(body) if body else None, caption, run.label)
        for run, body, caption in zip(runs, bodies, captions, strict=True)
    ]


def distributions(runs: Sequence[Run]) -> Section:
    """Latency distributions by priority: one plot, or one panel per priority with both runs."""
    from netlab.report import plot_distribution

    found = [latency_cdfs(run.trace) for run in runs]
    title = "Latency distribution by priority"
    if not any(cdf.latencies_s for cdfs in found for cdf in cdfs.values()):
        return Section("distribution", title, [Pane(None, "Nothing was delivered.")], short="Distribution")
    if len(runs) == 1:
        body = plot_distribution.latency_cdf(found[0])
    else:
        body = plot_distribution.latency_cdf_pair(found, [run.label for run in runs])
    caption = (
        "Share of the published messages that had arrived within a time, from the publish call to receipt by the "
        "application; the lower number is the more urgent. Messages that never came keep a curve below 100 %. Dotted: "
        "50 % and 99 %."
    )
    return Section("distribution", title, [Pane(figure(body))], caption, "Distribution")


def latencies(runs: Sequence[Run]) -> Section:
    """Every message over time."""
    from netlab.report import plots

    found = [data.latencies(run.trace) for run in runs]
    bodies = plots.latency_by_priority([(entry, run.marks) for entry, run in zip(found, runs, strict=True)])
    captions = ["" if entry else "Nothing was delivered." for entry in found]
    numbers = (
        " Rings: the worst instance of the expectation with that number." if any(r.marks.worst for r in runs) else ""
    )
    caption = f"Every delivered message at the time of its publication. {_TIME_PLOT}{numbers}"
    return Section("latency", "Latency over time", panes(runs, bodies, captions), caption, "Latency")


def message(runs: Sequence[Run]) -> Section:
    """The swim-lane of one message."""
    from netlab.report import plot_lane

    shown, lanes = [], [run.lane for run in runs]
    for run, lane in zip(runs, lanes, strict=True):
        if lane is None:
            shown.append(Pane(None, "No message was delivered.", run.label))
        elif not lane.flights:
            shown.append(Pane(None, f"{_message_name(lane)}: {_unseen(lane)}", run.label))
        else:
            body = plot_lane.swim_lane(lane, _down_ns(run), narrow=len(runs) > 1)
            why = tables.causes(run.story) if run.story is not None else ""
            shown.append(Pane(figure(body) + why, _story(lane), run.label))
    names = {_message_name(lane) for lane in lanes if lane is not None}
    title = "One message" + (f": {names.pop()}" if len(names) == 1 else "")
    caption = (
        "The way of one message through applications and interfaces; lines go from where a packet left to where it "
        "arrived, crosses are where it was lost. Idle times are cut out. Of a packet that several nodes passed on, the "
        "way is shown on which it first came. Another one: --message TOPIC#NUMBER."
    )
    return Section("message", title, shown, caption, "One message")


def _message_name(lane: Lane) -> str:
    return f"{typeset(str(lane.life.stream))} #{lane.life.published.seq}"


def _unseen(lane: Lane) -> str:
    if lane.is_opaque:
        return "its packets are not in the capture, or sealed by a key."
    reason = f" ({lane.life.published.reason})" if lane.life.published.reason else ""
    return f"no packet of it ever left{reason}."


def _story(lane: Lane) -> str:
    life = lane.life
    first, again, copies = (lane.count(cargo) for cargo in (Cargo.FIRST, Cargo.AGAIN, Cargo.COPY))
    lost = sum(lane.count(cargo, lost=True) for cargo in (Cargo.FIRST, Cargo.AGAIN, Cargo.COPY))
    acks_lost = lane.count(Cargo.ACK, lost=True)
    parts = [f"{_message_name(lane)}, priority {life.stream.priority}, {life.published.size_bytes} bytes"]
    if life.first_sent_ns is not None:
        parts.append(f"first sent after {milliseconds((life.first_sent_ns - lane.start_ns) / 1e9)}")
    parts.append(f"{counted(first, 'packet')} with fragments")
    parts += [f"{again} sent again"] if again else []
    parts += [f"{copies} as a copy"] if copies else []
    parts += [f"{lost} lost"] if lost else []
    parts += [f"{counted(acks_lost, 'acknowledgement')} lost"] if acks_lost else []
    fate = f"delivered after {milliseconds(life.delivery.latency_s)}" if life.delivery else "never delivered"
    return ", ".join([*parts, fate]) + "."


def _down_ns(run: Run) -> dict[tuple[str, str], list[tuple[int, int]]]:
    """The scene's times of links that were down on the capture's clock."""
    end_s = run.trace.duration_s + 3600.0

    def ns(at_s: float) -> int:
        return run.trace.t0_ns + round(min(at_s, end_s) * 1e9)

    return {pair: [(ns(a), ns(b)) for a, b in spans] for pair, spans in run.scene.down_s.items()}


def reconnects(runs: Sequence[Run]) -> Section:
    """What came first after each restoration."""
    from netlab.report import plot_distribution

    bodies = plot_distribution.reconnect_waterfall([run.falls for run in runs])
    captions = [_reconnect_caption(run) for run in runs]
    caption = (
        "The probe is the first datagram of one node that reached the other after the restoration, the answer the "
        "first that then came back to it; fresh is a message that was published since, or the newest one that was kept."
    )
    return Section("reconnects", "Reconnects", panes(runs, bodies, captions), caption)


def _reconnect_caption(run: Run) -> str:
    delays = sorted(fall.delivery_s for fall in run.falls if fall.delivery_s is not None)
    if not run.falls:
        return "No link was restored in this run."
    never = len(run.falls) - len(delays)
    words = counted(len(run.falls), "restoration")
    words += f", slowest {milliseconds(delays[-1])}" if delays else ""
    return words + (f", {never} after which nothing fresh came." if never else ".")


def arrivals(runs: Sequence[Run]) -> Section:
    """Times between messages of the heartbeat."""
    from netlab.report import plots

    found = [data.arrivals(run.trace, run.topic) if run.topic else [] for run in runs]
    shown = [sorted(entries, key=lambda entry: -len(entry.intervals_s))[:_PANELS_MAX] for entries in found]
    bodies = plots.intermessage_times(shown)
    captions = []
    for entries, part in zip(found, shown, strict=True):
        within = ", ".join(f"{entry.ratio_within:.0%} {typeset(str(entry.stream))}" for entry in part)
        told = f"Within 5 % of the nominal interval: {within}." + _left_out(len(entries) - len(part), "stream")
        missing = f"No stream has {data.INTERVALS_MIN} receipts of messages in succession."
        captions.append(told if part else missing)
    caption = (
        "Between receipts of messages that follow one another, with the normal distribution of the same mean and "
        "standard deviation (its central 68 % shaded). A gap is where messages in between never came, or the time was "
        "twice the nominal one or more."
    )
    topics = {run.topic for run in runs if run.topic}
    title = "Time between messages" + (f": {topics.pop()}" if len(topics) == 1 else "")
    return Section("arrivals", title, panes(runs, bodies, captions), caption, "Intervals")


def tunnel_map(runs: Sequence[Run]) -> Section:
    """Every node's path by whether it was connected to the base."""
    from netlab.report import plot_map

    drawn = [
        (
            run.scene,
            _contacts(run),
            run.base,
        )
        for run in runs
    ]
    captions = ["" if run.scene.paths else "The capture holds no poses." for run in runs]
    base = next((run.base for run in runs if run.base), "the base")
    caption = (
        f"Connected to {base}, the star: what was published up to {data.CONNECTED_WITHIN_S:g} s ago, or two of the "
        "longest publishing intervals, has come through in that time, in either direction. Dots are where nodes were "
        "last."
    )
    return Section("map", "Map", panes(runs, plot_map.tunnel_maps(drawn), captions), caption)


def _contacts(run: Run) -> dict[str, data.Contact]:
    nodes = [node for node in run.scene.paths if run.base and node != run.base]
    return {node: data.Contact(run.trace, node, run.base or "") for node in nodes}


def volumes(runs: Sequence[Run]) -> Section:
    """Delivered payload by topic and node."""
    from netlab.report import plots

    found = [data.volumes(run.trace) for run in runs]
    totals = [sum(size for by_node in entry.values() for size in by_node.values()) for entry in found]
    captions = [f"{plots.size_text(total)} in all." if total else "Nothing was delivered." for total in totals]
    caption = "Delivered payload by the node that published it, each message once per destination."
    return Section(
        "volume", "Data volume by topic and node", panes(runs, plots.data_volumes(found), captions), caption, "Volume"
    )


def waiting(runs: Sequence[Run]) -> Section:
    """What was published and had not been delivered."""
    from netlab.report import plots

    found = [data.waiting(run.trace) for run in runs]
    bodies = plots.queue_depths([(entry, run.marks) for entry, run in zip(found, runs, strict=True)])
    captions = ["" if entry else "Nothing was delivered." for entry in found]
    caption = (
        "Payload published and not yet delivered, by publishing node; of messages that came through in the end. "
        f"{_TIME_PLOT}"
    )
    return Section("queues", "Queue depths", panes(runs, bodies, captions), caption, "Queues")


def strengths(runs: Sequence[Run]) -> Section | None:
    """Signal strengths; None where no radio tells them."""
    if not any(run.scene.rssi_dbm for run in runs):
        return None
    caption = "Mean at the receiver, sender > receiver."
    return _grids(runs, "signal", "Signal strength", lambda run: run.scene.rssi_dbm, "signal strength, dBm", caption)


def link_quality(runs: Sequence[Run]) -> Section:
    """The share of frames that arrived."""
    caption = "Of the frames sent in range, sender > receiver; blank where none was sent."
    label = "share of frames that arrived"
    return _grids(runs, "links", "Link quality", lambda run: run.scene.success, label, caption, least=0.0, most=1.0)


def _grids(
    runs: Sequence[Run],
    anchor: str,
    title: str,
    series: Callable[[Run], Mapping[str, list[tuple[float, float]]]],
    label: str,
    caption: str,
    least: float | None = None,
    most: float | None = None,
) -> Section:
    from netlab.report import plots

    chosen = [_rows(series(run)) for run in runs]
    grids = [_grid(run, rows) for run, rows in zip(runs, chosen, strict=True)]
    bodies = plots.link_quality(grids, label=label, least=least, most=most)
    none = "The capture holds no decisions on frames: with the netem engine they are the kernel's own."
    captions = [
        _left_out(len(series(run)) - len(rows), "pair", "that never or less heard each other") if rows else none
        for run, rows in zip(runs, chosen, strict=True)
    ]
    return Section(anchor, title, panes(runs, bodies, captions), caption)


def _rows(series: Mapping[str, list[tuple[float, float]]]) -> dict[str, list[tuple[float, float]]]:
    """The pairs that were heard at all; of many those with the most to show."""
    heard = [pair for pair, samples in series.items() if any(value != 0 for _, value in samples)]
    return {pair: series[pair] for pair in sorted(sorted(heard, key=lambda pair: -len(series[pair]))[:_ROWS_MAX])}


def _grid(run: Run, series: Mapping[str, list[tuple[float, float]]]) -> data.Grid:
    columns = max(min(_GRID_COLUMNS, math.floor(run.trace.duration_s)), 1)
    return data.grid(series, start_s=0.0, end_s=max(run.trace.duration_s, 1.0), columns=columns)


def _left_out(count: int, what: str, which: str = "") -> str:
    return f" {count} more {what}{'s' * (count > 1)}{which and ' ' + which} not shown." if count > 0 else ""
