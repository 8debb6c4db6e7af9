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
from netlab.tui.wording import counted, ms, rate, size, wrapped

_LEAST_SPARK = 8
_TIME_WIDTH = 10  # a time and a sign
_STATES = {"ready": "#35c48d", "starting": "#e5c453", "exited": "#e0485f"}


def head_text(model: LiveModel, standing: Standing, width: int) -> Text:
    """Name, time with a bar, whether the timeline stands still, what is recorded; the engine where there is room."""
    t_s = max(0.0, standing.t_s or 0.0)
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(f" {model.name} ", style=f"bold {palette.CHOSEN} on #24415c")
    if standing.phase == "running":
        label, style = ("‖ timeline held", "bold #e5c453") if standing.held else ("▶ running", "#35c48d")
    else:
        label, style = standing.phase, palette.DIM
    text.append(f" {label} ", style=style)
    text.append(f" {min(t_s, standing.end_s):5.1f} / {round(standing.end_s, 1):g} s ", style=palette.TEXT)
    bar = max(6, min(30, width - 84))
    done = round(bar * min(1.0, t_s / standing.end_s)) if standing.end_s else 0
    text.append("━" * done, style=palette.ACCENT)
    text.append("━" * (bar - done), style="#2b333d")
    file = standing.recording
    if file or standing.phase != "finished":
        text.append("  ● rec " if file else "  ○ not recording ", style="bold #e0485f" if file else palette.DIM)
    if file:
        text.append(file.rsplit("/", 1)[-1], style=palette.DIM)
    engine = f"  engine {model.engine}"
    text.append(engine if text.cell_len + len(engine) <= width else "", style=palette.DIM)
    return text


def overview_text(model: LiveModel, standing: Standing, *, width: int) -> Text:
    """While nothing is chosen: the team, and what went wrong, in whole sentences."""
    text = Text(no_wrap=True, overflow="ellipsis")
    name_width = max(8, min(14, width - 21))
    _section(text, f"{counted(len(model.nodes), 'node'):<{name_width + 2}}{'peers':<9}queued")
    for node in model.nodes.values():
        exited = [row for row in standing.processes_of(node.name) if row["state"] == "exited" and row["exit_status"]]
        style = "#e0485f" if exited else palette.TEXT if node.active else palette.GONE
        queued = sum(waits.size_bytes for waits in node.queues.by_priority().values())
        told = f"{len(node.online)}" if node.peers else ("" if node.active else "carried")
        text.append(f" {'●' if node.active else '○'} {node.name:<{name_width}}", style=style)
        text.append(f"{told:<9}{size(queued) if queued else ''}\n", style=palette.DIM)
    if standing.troubles:
        _section(text, "troubles")
        for trouble in standing.troubles[-5:]:
            _sentence(text, trouble.splitlines()[0], width, palette.WARNING)
    text.append("\n → a node, ↓ a link, ? the tour\n", style=palette.DIM)
    return text


def verdict_text(brief: str, *, width: int) -> Text:
    """How the run went, in whole sentences."""
    text = Text(no_wrap=True)
    for line in brief.splitlines():
        indent = len(line) - len(line.lstrip())
        style = palette.WARNING if line.lstrip().startswith("NOT MET") else palette.TEXT if indent else palette.ACCENT
        for part in wrapped(line.strip(), width, indent=indent + 1) or [""]:
            text.append(f"{part}\n", style=style)
    return text


def tour_text(title: str, what: str, place: int) -> Text:
    """One step of the tour."""
    text = Text()
    text.append(f"{place + 1}/{len(STEPS)}  {title}   ", style=f"bold {palette.CHOSEN}")
    text.append(what)
    return text


def node_text(node: Node, standing: Standing, *, width: int, lines: int) -> Text:
    """Peers, queues, what waits for peers that are away, processes, the tail of the log."""
    text = Text(no_wrap=True, overflow="ellipsis")
    _title(text, node.name, "" if node.active else "carried")
    if node.position_m is not None:
        text.append(f"  {node.position_m[0]:.1f}, {node.position_m[1]:.1f} m", style=palette.DIM)
    text.append("\n")
    _processes(text, standing.processes_of(node.name))
    _peers(text, node, width)
    _queues(text, node, width)
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
    percents = (50, 99) if wide else (50,)
    name_width = 34 if width >= 100 else 26 if wide else 17
    free = width - 14 - 9 * len(percents)  # for names and sparklines
    spark = min(60, free - name_width - 2)
    if spark < _LEAST_SPARK:
        name_width, spark = max(8, min(34, free)), 0
    heads = "".join(f"{head:>9}" for head in ("median", "p99")[: len(percents)])
    history = f"  last {spark} s" if spark else ""
    text.append(f" {'':<{name_width}}{heads}{'delivered':>13}{history}\n", style=palette.DIM)

    def line(name: str, window: LatencyWindow, count: str, colour: str, *, bold: bool, lacks: bool) -> None:
        text.append(f" {name[: name_width - 1]:<{name_width}}", style=f"bold {colour}" if bold else colour)
        for percent in percents:
            latency_s = window.percentile_s(percent, now_s=now_s)
            text.append(f"{ms(latency_s):>9}", style=palette.latency(latency_s))
        text.append(f"{count:>13}", style=palette.WARNING if lacks else palette.DIM)
        history = f"  {sparkline(window.series_s(spark, now_s=now_s))}" if spark else ""
        text.append(f"{history}\n", style=colour)

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


def timeline_text(model: LiveModel, standing: Standing, *, width: int, lines: int) -> Text:
    """What has been done, then a line for now, then what comes; the newest of what there is room for."""
    past = [
        _moment_text(moment.at_s, "✎" if moment.by_hand else "", moment.label, width, by_hand=moment.by_hand)
        for moment in list(model.moments)[-lines:]
        if moment.kind != "start"
    ]
    coming = [
        _moment_text(row["at_s"], "", row["label"], width, comes=True)
        for row in _without_repeats(standing.coming)[: max(2, lines // 2)]
    ]
    if not coming and standing.t_s:
        coming = [Text(f"{'':10}nothing comes any more\n", style=palette.DIM)]
    sign, style = ("‖", "bold #e5c453") if standing.held else ("▶", "bold #35c48d")
    now = Text(f"{max(0.0, standing.t_s or 0.0):7.1f} {sign} now ────────────\n", style=style)
    after = Text().join([now, *coming])
    room = max(1, lines - after.plain.count("\n"))
    done = Text().join(past).split("\n", include_separator=True, allow_blank=False)[-room:]
    return Text(no_wrap=True, overflow="ellipsis").join([*done, after])


def _moment_text(at_s: float, sign: str, label: str, width: int, *, by_hand: bool = False, comes: bool = False) -> Text:
    style = palette.DIM if comes else palette.ACCENT if by_hand else palette.TEXT
    text = Text(f"{at_s:7.1f} {sign:<2}", style=palette.DIM)
    first, *rest = wrapped(label, width, indent=_TIME_WIDTH) or [""]
    text.append("\n".join([first.strip(), *rest]) + "\n", style=style)
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


def _sentence(text: Text, sentence: str, width: int, style: str) -> None:
    """In as many lines as it takes."""
    for line in wrapped(sentence, width, indent=1):
        text.append(f"{line}\n", style=style)


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


def _peers(text: Text, node: Node, width: int) -> None:
    name_width = max(8, min(14, width - 24))  # a sign, 8 for the round trip, 13 for the rate
    head = f"peers {len(node.online)} online"
    _section(text, f"{head}{'rtt':>{name_width + 10 - len(head)}}{'rate':>13}")
    for name, peer in sorted(node.peers.items(), key=lambda item: (not item[1].online, item[0]))[:8]:
        style = palette.TEXT if peer.online else palette.GONE
        text.append(f" {'●' if peer.online else '○'} {name:<{name_width}}", style=style)
        told = f"{ms(peer.srtt_s):>8}{rate(peer.rate_bps):>13}" if peer.online else f"{'offline':>8}"
        text.append(f"{told}\n", style=style)
    if len(node.peers) > 8:
        text.append(f"   and {len(node.peers) - 8} more\n", style=palette.DIM)


def _queues(text: Text, node: Node, width: int) -> None:
    _section(text, "queues")
    queues = node.queues.by_priority()
    most = max((waiting.size_bytes for waiting in queues.values()), default=1) or 1
    for number, waiting in list(queues.items())[:6]:
        bar = "█" * max(1, round(12 * waiting.size_bytes / most))
        text.append(f" p{number:<2} {bar:<12}", style=palette.priority(number))
        text.append(f" {size(waiting.size_bytes):>8} in {waiting.messages}\n", style=palette.TEXT)
    if not queues:
        text.append(" empty\n", style=palette.DIM)
    offline = node.queues.offline(node.online)
    stored = node.queues.stored()
    if offline.messages or stored:
        kept = sum(waiting.messages for waiting in stored.values())
        stored_bytes = sum(waiting.size_bytes for waiting in stored.values())
        away = (
            f"for peers away: {offline.messages} in memory, {kept} stored ({size(offline.size_bytes + stored_bytes)})"
        )
        _sentence(text, away, width, "#e5c453")
    if node.queues.dropped:
        told = ", ".join(f"{reason} {count}" for reason, count in sorted(node.queues.dropped.items()))
        _sentence(text, f"dropped: {told}", width, palette.WARNING)
    if node.retransmissions:
        text.append(f" {counted(node.retransmissions, 'fragment')} sent again\n", style=palette.DIM)


def _direction_rows(direction: Direction) -> Iterable[tuple[str, str]]:
    yield "state", direction.state.replace("_", " ")
    if direction.snr_db is not None and direction.rssi_dbm is not None:
        yield "signal", f"{direction.rssi_dbm:.0f} dBm, SNR {direction.snr_db:.0f} dB"
    if direction.loss_ratio:
        yield "loss", f"{direction.loss_ratio:.2%}"
    if direction.delay_s:
        yield "delay", ms(direction.delay_s)
    if direction.rate_bps:
        yield "rate", rate(direction.rate_bps)


LEVELS = {LogLevel.WARNING: palette.WARNING, LogLevel.ERROR: "#e0485f", LogLevel.FATAL: "#e0485f"}
