"""The swim-lane of one message: lanes are applications and interfaces, time goes to the right. Data in, SVG out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from netlab.report import palette
from netlab.report.drawing import NARROW_IN, WIDTH_IN, columns_that_fit, in_style, legend_row, svg
from netlab.report.lane import Cargo, Flight, Lane, busy_spans, thinned_flights
from netlab.traces.model import Interface

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FLIGHT_COLUMNS = 120
_LANE_IN = 0.42
_Dash = Literal["-", "--", "-.", ":"]
#: colour, dash, width, marker where it leaves
_LOOKS: dict[Cargo, tuple[str, _Dash, float, str]] = {
    Cargo.FIRST: (palette.SERIES[0], "-", 1.2, "o"),
    Cargo.AGAIN: (palette.SERIES[1], "--", 1.8, "D"),
    Cargo.COPY: (palette.SERIES[3], "-.", 1.5, "s"),
    Cargo.ACK: (palette.SERIES[2], ":", 1.3, "."),
}
Span = tuple[int, int]


@dataclass(frozen=True, slots=True)
class _Rows:
    """Where each lane is: applications at the ends, interfaces between."""

    published: int
    delivered: int
    by_interface: Mapping[Interface, int]
    by_node: Mapping[str, int]

    def at(self, interface: Interface) -> int:
        return self.by_interface.get(interface, self.by_node.get(interface[0], self.delivered))


@in_style
def swim_lane(lane: Lane, down_ns: Mapping[tuple[str, str], Sequence[Span]], *, narrow: bool = False) -> str:
    """Draw a message's life; idle times are cut out. ``down_ns``: when directed pairs of nodes had no link."""
    rows, names = _rows(lane)
    spans = [_padded(span, lane) for span in busy_spans(lane)]
    widths = [max(end - start, 0.25 * max(b - a for a, b in spans)) for start, end in spans]
    height_in = 1.25 + _LANE_IN * len(names)
    figure = Figure(figsize=(NARROW_IN if narrow else WIDTH_IN, height_in), layout="constrained")
    panels = figure.subplots(1, len(spans), squeeze=False, sharey=True, width_ratios=widths)[0]
    for number, (axes, span) in enumerate(zip(panels, spans, strict=True)):
        _panel(axes, lane, rows, span, down_ns)
        if number:
            axes.tick_params(axis="y", length=0)
            axes.spines["left"].set_linestyle((0, (2, 3)))
        axes.locator_params(axis="x", nbins=max(2, round(8 * widths[number] / sum(widths))))
    panels[0].set_yticks(range(len(names)), names)
    panels[0].set_ylim(len(names) - 0.5, -0.6)
    figure.supxlabel("time since it was published, ms", fontsize=9, color=palette.INK)
    handles = _keys(lane, any(_shown_spans(lane, down_ns, span) for span in spans))
    columns = columns_that_fit([str(handle.get_label()) for handle in handles], figure.get_figwidth() - 0.2)
    figure.legend(handles=handles, loc="outside upper left", **legend_row(columns))
    return svg(figure, "Swim-lane of one message from the publish call to its delivery")


def _rows(lane: Lane) -> tuple[_Rows, list[str]]:
    stream = lane.life.stream
    names = [f"{stream.source}: application", *("/".join(interface) for interface in lane.interfaces)]
    names.append(f"{stream.destination}: application")
    by_interface = {interface: row for row, interface in enumerate(lane.interfaces, start=1)}
    by_node: dict[str, int] = {}
    for interface, row in by_interface.items():
        by_node.setdefault(interface[0], row)
    return _Rows(0, len(names) - 1, by_interface, by_node), names


def _padded(span: Span, lane: Lane) -> tuple[float, float]:
    whole = max(end - start for start, end in busy_spans(lane))
    margin = max(0.04 * whole, 200_000)
    return span[0] - margin, span[1] + margin


def _panel(
    axes: Axes,
    lane: Lane,
    rows: _Rows,
    span: tuple[float, float],
    down_ns: Mapping[tuple[str, str], Sequence[Span]],
) -> None:
    def ms(t_ns: float) -> float:
        return (t_ns - lane.start_ns) / 1e6

    axes.set_xlim(ms(span[0]), ms(span[1]))
    axes.grid(False)
    for row in range(rows.delivered + 1):
        axes.axhline(row, color=palette.FAINT, linewidth=1.2, zorder=0.5)
    for pair, start_ns, end_ns in _shown_spans(lane, down_ns, span):
        ends = sorted((rows.by_node[pair[0]], rows.by_node[pair[1]]))
        axes.fill_between(
            [ms(max(start_ns, span[0])), ms(min(end_ns, span[1]))],
            ends[0],
            ends[1],
            facecolor="none",
            edgecolor=palette.UNKNOWN,
            hatch="////",
            linewidth=0,
            alpha=0.45,
            zorder=0.3,
        )
    inside = [flight for flight in lane.flights if span[0] <= flight.sent_ns <= span[1]]
    for flight in thinned_flights(inside, columns=_FLIGHT_COLUMNS):
        _flight(axes, flight, rows, ms, ms(span[1]) - ms(span[0]))
    _ends(axes, lane, rows, ms, span)


def _flight(axes: Axes, flight: Flight, rows: _Rows, ms: Callable[[float], float], width_ms: float) -> None:
    colour, dash, width, marker = _LOOKS[flight.cargo]
    start, at, to = ms(flight.sent_ns), rows.at(flight.sender), rows.at(flight.receiver)
    axes.plot(start, at, marker, color=colour, markersize=4, zorder=3)
    if flight.arrived_ns is not None:
        axes.plot([start, ms(flight.arrived_ns)], [at, to], color=colour, linestyle=dash, linewidth=width, zorder=2)
        return
    half = at + 0.55 * (to - at)
    end = start + 0.012 * width_ms
    axes.plot([start, end], [at, half], color=colour, linestyle=dash, linewidth=width, zorder=2)
    axes.plot(end, half, "x", color=palette.BAD, markersize=7, markeredgewidth=2.2, zorder=4)


def _ends(axes: Axes, lane: Lane, rows: _Rows, ms: Callable[[float], float], span: tuple[float, float]) -> None:
    """The publish call, the way down to the first packet, the delivery and the way to it."""
    sends = [flight for flight in lane.flights if flight.cargo is not Cargo.ACK]
    if span[0] <= lane.start_ns <= span[1]:
        axes.plot(0, rows.published, ">", color=palette.INK, markersize=9, zorder=5)
        if sends:
            first = sends[0]
            axes.plot([0, ms(first.sent_ns)], [0, rows.at(first.sender)], color=palette.INK, linewidth=1, zorder=1)
    delivery = lane.life.delivery
    if delivery is not None and span[0] <= delivery.t_ns <= span[1]:
        target = lane.life.stream.destination
        arrivals = [f for f in sends if f.receiver[0] == target and f.arrived_ns and f.arrived_ns <= delivery.t_ns]
        if arrivals:
            last = max(arrivals, key=lambda flight: flight.arrived_ns or 0)
            x, y = [ms(last.arrived_ns or 0), ms(delivery.t_ns)], [rows.at(last.receiver), rows.delivered]
            axes.plot(x, y, color=palette.INK, linewidth=1, zorder=1)
        axes.plot(ms(delivery.t_ns), rows.delivered, "*", color=palette.INK, markersize=14, zorder=5)


def _shown_spans(
    lane: Lane, down_ns: Mapping[tuple[str, str], Sequence[Span]], span: tuple[float, float]
) -> list[tuple[tuple[str, str], int, int]]:
    """When links between lanes were down inside a span; one direction stands for both."""
    used = {tuple(sorted((flight.sender[0], flight.receiver[0]))) for flight in lane.flights}
    lanes = {interface[0] for interface in lane.interfaces}
    return [
        (pair, start_ns, end_ns)
        for pair, found in down_ns.items()
        if tuple(sorted(pair)) in used and set(pair) <= lanes and (pair[::-1] not in down_ns or pair < pair[::-1])
        for start_ns, end_ns in found
        if start_ns < span[1] and end_ns > span[0]
    ]


def _keys(lane: Lane, is_down: bool) -> list[Line2D | Patch]:
    keys: list[Line2D | Patch] = [Line2D([], [], color=palette.INK, linestyle="", marker=">", label="published")]
    for cargo, (colour, dash, width, marker) in _LOOKS.items():
        if any(flight.cargo is cargo for flight in lane.flights):
            line = Line2D([], [], color=colour, linestyle=dash, linewidth=width, marker=marker, label=cargo.value)
            keys.append(line)
    for why in sorted({flight.lost for flight in lane.flights if flight.arrived_ns is None}):
        name = why if why == "lost" else f"lost: {why}"
        keys.append(Line2D([], [], color=palette.BAD, linestyle="", marker="x", markeredgewidth=2.2, label=name))
    if is_down:
        keys.append(Patch(facecolor="none", edgecolor=palette.UNKNOWN, hatch="////", linewidth=0, label="link down"))
    if lane.life.delivery is not None:
        keys.append(Line2D([], [], color=palette.INK, linestyle="", marker="*", markersize=11, label="delivered"))
    return keys
