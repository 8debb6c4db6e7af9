"""The text of the panels: a node, a link, streams, the timeline, the head. From a model to rich text; no terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.text import Text

from netlab.capture.schemas import LogLevel
from netlab.live.links import Direction, Link
from netlab.live.model import LiveModel, Node
from netlab.live.windows import LatencyWindow, sparkline
from netlab.tui import palette
from netlab.tui.standing import Standing
from netlab.tui.tour import STEPS

_STATES = {"ready": "#35c48d", "starting": "#e5c453", "exited": "#e0485f"}


def head_text(model: LiveModel, standing: Standing, width: int) -> Text:
    """Name, time with a bar, whether the timeline stands still, what is recorded."""
    t_s = max(0.0, standing.t_s or 0.0)
    text = Text(no_wrap=True)
    text.append(f" {model.name} ", style=f"bold {palette.CHOSEN} on #24415c")
    if standing.phase == "running":
        label, style = ("‖ timeline held", "bold #e5c453") if standing.held else ("▶ running", "#35c48d")
    else:
        label, style = standing.phase, palette.DIM
    text.append(f" {label} ", style=style)
    text.append(f" {min(t_s, standing.end_s):5.1f} / {standing.end_s:g} s ", style=palette.TEXT)
    bar = max(6, min(30, width - 84))
    done = round(bar * min(1.0, t_s / standing.end_s)) if standing.end_s else 0
    text.append("━" * done, style=palette.ACCENT)
    text.append("━" * (bar - done), style="#2b333d")
    file = standing.recording
    text.append("  ● rec " if file else "  ○ not recording ", style="bold #e0485f" if file else palette.DIM)
    if file:
        text.append(file.rsplit("/", 1)[-1], style=palette.DIM)
    text.append(f"  engine {model.engine}", style=palette.DIM)
    return text


def overview_text(model: LiveModel, standing: Standing) -> Text:
    """While nothing is chosen: the team, and what went wrong."""
    text = Text(no_wrap=True, overflow="ellipsis")
    _section(text, f"{len(model.nodes)} nodes")
    for node in model.nodes.values():
        exited = [row for row in standing.processes_of(node.name) if row["state"] == "exited" and row["exit_status"]]
        style = "#e0485f" if exited else palette.TEXT if node.active else palette.GONE
        waiting = sum(waits.size_bytes for waits in node.queues.by_priority().values())
        told = f"{len(node.online)} peers" if node.peers else ("" if node.active else "carried")
        text.append(f" {'●' if node.active else '○'} {node.name:<14}", style=style)
        text.append(f"{told:<9} {_size(waiting) + ' waiting' if waiting else ''}\n", style=palette.DIM)
    if standing.troubles:
        _section(text, "troubles")
        for trouble in standing.troubles[-5:]:
            text.append(f" {trouble.splitlines()[0]}\n", style=palette.WARNING)
    text.append("\n → picks a node, ↓ a link, ? is a tour\n", style=palette.DIM)
    return text


def tour_text(title: str, what: str, place: int) -> Text:
    """One step of the tour."""
    text = Text()
    text.append(f"{place + 1}/{len(STEPS)}  {title}   ", style=f"bold {palette.CHOSEN}")
    text.append(what)
    text.append("   (? leaves the tour, Enter skips)", style=palette.DIM)
    return text


def node_text(node: Node, standing: Standing, *, lines: int) -> Text:
    """Peers, queues, what waits for peers that are away, processes, the tail of the log."""
    text = Text(no_wrap=True, overflow="ellipsis")
    _title(text, node.name, "" if node.active else "carried")
    if node.position_m is not None:
        text.append(f"  {node.position_m[0]:.1f}, {node.position_m[1]:.1f} m", style=palette.DIM)
    text.append("\n")
    _processes(text, standing.processes_of(node.name))
    _peers(text, node)
    _queues(text, node)
    used = len(text.plain.splitlines())
    _section(text, "log")
    for at_s, process, level, message in list(node.log)[-max(2, lines - used - 2) :]:
        style = LEVELS.get(level, palette.TEXT)
        text.append(f" {at_s:6.1f} ", style=palette.DIM)
        text.append(f"{process}: {message}\n", style=style)
    if not node.log:
        text.append(" nothing written so far\n", style=palette.DIM)
    return text


def link_text(link: Link) -> Text:
    """State and words of each direction."""
    text = Text(no_wrap=True, overflow="ellipsis")
    _title(text, f"{link.a} — {link.b}", "")
    text.append(f"  {palette.SIGNS[link.grade]} {link.grade}\n", style=palette.GRADES[link.grade])
    for (sender, receiver, segment), direction in sorted(link.directions.items()):
        _section(text, f"{sender} → {receiver}  {segment}")
        for name, value in _direction_rows(direction):
            text.append(f" {name:<9}", style=palette.DIM)
            text.append(f"{value}\n", style=palette.GRADES[direction.grade] if name == "state" else palette.TEXT)
    return text


def streams_text(model: LiveModel, *, width: int, lines: int) -> Text:
    """A line for each priority, then as many streams as there is room for, most urgent first.

    Each with the median and the 99th percentile of the last ten seconds, delivered of sent, and a minute of medians.
    """
    now_s = model.now_ns / 1e9
    text = Text(no_wrap=True, overflow="ellipsis")
    wide = width >= 62
    name_width = 34 if width >= 100 else 26 if wide else 17
    percents = (50, 99) if wide else (50,)
    spark = max(0, min(60, width - name_width - 16 - 9 * len(percents)))
    heads = "".join(f"{head:>9}" for head in ("median", "p99")[: len(percents)])
    text.append(f" {'':<{name_width}}{heads}{'delivered':>13}  last {spark} s\n", style=palette.DIM)

    def line(name: str, window: LatencyWindow, count: str, colour: str, *, bold: bool, lacks: bool) -> None:
        text.append(f" {name[: name_width - 1]:<{name_width}}", style=f"bold {colour}" if bold else colour)
        for percent in percents:
            latency_s = window.percentile_s(percent, now_s=now_s)
            text.append(f"{_ms(latency_s):>9}", style=palette.latency(latency_s))
        text.append(f"{count:>13}  ", style=palette.WARNING if lacks else palette.DIM)
        text.append(sparkline(window.series_s(spark, now_s=now_s)) + "\n", style=colour)

    for number, window in sorted(model.priorities.items()):
        line(f"priority {number}", window, str(window.delivered), palette.priority(number), bold=True, lacks=False)
    streams = sorted(model.streams.values(), key=lambda stream: (stream.priority, stream.index))
    for stream in streams[: max(0, lines - len(model.priorities) - 1)]:
        name, colour = f"{stream.topic} {stream.source}→{stream.destination}", palette.priority(stream.priority)
        missing = stream.sent - stream.window.delivered
        count = f"{stream.window.delivered}/{stream.sent}"
        line(name, stream.window, count, colour, bold=False, lacks=missing > 0.1 * stream.sent + 2)
    if not model.streams:
        text.append(" this scenario has no traffic\n", style=palette.DIM)
    return text


def timeline_text(model: LiveModel, standing: Standing, *, lines: int) -> Text:
    """What has been done, then a line for now, then what comes."""
    text = Text(no_wrap=True, overflow="ellipsis")
    coming = _without_repeats(standing.coming)[: max(2, lines // 2)]
    past = [m for m in model.moments if m.kind not in ("start",)][-max(1, lines - 1 - len(coming)) :]
    for moment in past:
        hand = moment.by_hand
        text.append(f" {moment.at_s:7.1f} ", style=palette.DIM)
        text.append(f"{'✎ ' if hand else '  '}{moment.label}\n", style=palette.ACCENT if hand else palette.TEXT)
    t_s = max(0.0, standing.t_s or 0.0)
    sign = "‖" if standing.held else "▶"
    text.append(f" {t_s:7.1f} {sign} now ────────────\n", style="bold #e5c453" if standing.held else "bold #35c48d")
    for row in coming:
        text.append(f" {row['at_s']:7.1f}   {row['label']}\n", style=palette.DIM)
    if not coming:
        text.append("           nothing comes any more\n" if standing.t_s else "", style=palette.DIM)
    return text


def _without_repeats(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """One line per moment and label."""
    return list({(row["at_s"], row["label"]): row for row in rows}.values())


def _title(text: Text, name: str, remark: str) -> None:
    text.append(f" {name}", style=f"bold {palette.CHOSEN}")
    if remark:
        text.append(f" ({remark})", style=palette.WARNING)


def _section(text: Text, name: str) -> None:
    text.append(f" {name}\n", style=f"{palette.ACCENT}")


def _processes(text: Text, processes: list[Mapping[str, Any]]) -> None:
    for process in processes:
        state = str(process["state"])
        text.append(f" ● {process['process']} ", style=_STATES.get(state, palette.TEXT))
        status = process["exit_status"]
        told = state if status in (None, 0) or state != "exited" else f"exited {status}"
        text.append(f"{told} ", style=palette.DIM if state == "ready" else _STATES.get(state, palette.TEXT))
        text.append("\n")
    if not processes:
        text.append(" no process\n", style=palette.DIM)


def _peers(text: Text, node: Node) -> None:
    _section(text, f"peers {len(node.online)} online{'':<7}rtt      rate")
    for name, peer in sorted(node.peers.items(), key=lambda item: (not item[1].online, item[0]))[:8]:
        style = palette.TEXT if peer.online else palette.GONE
        text.append(f" {'●' if peer.online else '○'} {name:<14}", style=style)
        text.append(f"{_ms(peer.srtt_s):>9} {_rate(peer.rate_bps):>9}\n" if peer.online else "  offline\n", style=style)
    if len(node.peers) > 8:
        text.append(f"   and {len(node.peers) - 8} more\n", style=palette.DIM)


def _queues(text: Text, node: Node) -> None:
    _section(text, "queues")
    queues = node.queues.by_priority()
    most = max((waiting.size_bytes for waiting in queues.values()), default=1) or 1
    for number, waiting in list(queues.items())[:6]:
        bar = "█" * max(1, round(12 * waiting.size_bytes / most))
        text.append(f" p{number:<2} {bar:<12}", style=palette.priority(number))
        text.append(f" {_size(waiting.size_bytes):>8} in {waiting.messages}\n", style=palette.TEXT)
    if not queues:
        text.append(" empty\n", style=palette.DIM)
    offline = node.queues.offline(node.online)
    stored = node.queues.stored()
    if offline.messages or stored:
        kept = sum(waiting.messages for waiting in stored.values())
        size = sum(waiting.size_bytes for waiting in stored.values())
        text.append(f" for peers away: {offline.messages} in memory, {kept} stored", style="#e5c453")
        text.append(f" ({_size(offline.size_bytes + size)})\n", style=palette.DIM)
    if node.queues.dropped:
        told = ", ".join(f"{reason} {count}" for reason, count in sorted(node.queues.dropped.items()))
        text.append(f" dropped: {told}\n", style=palette.WARNING)
    if node.retransmissions:
        text.append(f" {node.retransmissions} fragments sent again\n", style=palette.DIM)


def _direction_rows(direction: Direction) -> Iterable[tuple[str, str]]:
    yield "state", direction.state.replace("_", " ")
    if direction.snr_db is not None and direction.rssi_dbm is not None:
        yield "signal", f"{direction.rssi_dbm:.0f} dBm, {direction.snr_db:.0f} dB over noise"
    if direction.loss_ratio:
        yield "loss", f"{direction.loss_ratio:.2%}"
    if direction.delay_s:
        yield "delay", _ms(direction.delay_s)
    if direction.rate_bps:
        yield "rate", _rate(direction.rate_bps)


def _ms(value_s: float | None) -> str:
    if value_s is None:
        return "-"
    return f"{value_s * 1e3:.1f} ms" if value_s < 1 else f"{value_s:.1f} s"


def _rate(value_bps: float | None) -> str:
    if not value_bps:
        return "-"
    for unit, factor in (("Gbit/s", 1e9), ("Mbit/s", 1e6), ("kbit/s", 1e3)):
        if value_bps >= factor:
            return f"{value_bps / factor:.3g} {unit}"
    return f"{value_bps:.0f} bit/s"


def _size(value_bytes: float) -> str:
    for unit, factor in (("MB", 1e6), ("kB", 1e3)):
        if value_bytes >= factor:
            return f"{value_bytes / factor:.3g} {unit}"
    return f"{value_bytes:.0f} B"


LEVELS = {LogLevel.WARNING: palette.WARNING, LogLevel.ERROR: "#e0485f", LogLevel.FATAL: "#e0485f"}
