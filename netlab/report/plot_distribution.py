"""The plots of distributions and reconnects: data in, SVG out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from netlab.report import palette
from netlab.report.cdf import Cdf
from netlab.report.drawing import (
    COLUMNS,
    NARROW_IN,
    WIDTH_IN,
    in_style,
    legend_above,
    look,
    new_figure,
    same_axes,
    svg,
    width_of,
)
from netlab.report.waterfall import Fall

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FALLS_MAX = 24


@in_style
def latency_cdf(found: Mapping[int, Cdf]) -> str:
    """What share of the published messages had arrived within what time, one curve per priority."""
    figure, (axes,) = new_figure(1, 1, height_in=3.4)
    for number, (priority, cdf) in enumerate(found.items()):
        own = look(number)
        _curve(axes, cdf, own.colour, own.dash, own.marker, f"priority {priority}")
    _finish(axes)
    same_axes([axes])
    legend_above(axes, width_in=WIDTH_IN - 0.8)
    return svg(figure, "Distribution of latencies by priority")


@in_style
def latency_cdf_pair(runs: Sequence[Mapping[int, Cdf]], labels: Sequence[str]) -> str:
    """One panel per priority with a curve of each run."""
    priorities = sorted({priority for found in runs for priority in found})
    columns = min(len(priorities), 2)
    rows = math.ceil(len(priorities) / columns)
    figure, axes = new_figure(rows, columns, height_in=2.5, width_in=2 * NARROW_IN)
    for panel, priority in zip(axes, priorities, strict=False):
        for number, found in enumerate(runs):
            if priority in found:
                own = look(number)
                _curve(panel, found[priority], own.colour, own.dash, own.marker, labels[number])
        _finish(panel)
        panel.set_title(f"priority {priority}", pad=20)
        legend_above(panel, width_in=NARROW_IN - 0.8)
    same_axes([panel for panel in axes if panel.has_data()])
    return svg(figure, "Distributions of latencies by priority, both runs in each panel")


def _curve(axes: Axes, cdf: Cdf, colour: str, dash: str, marker: str, label: str) -> None:
    corners = cdf.steps(columns=COLUMNS)
    if not corners:
        axes.plot([], [], color=colour, linestyle=dash, marker=marker, label=f"{label} (nothing delivered)")
        return
    x = [max(latency_s, 1e-6) * 1e3 for latency_s, _ in corners]
    y = [0.0, *(share for _, share in corners)]
    axes.step([x[0], *x], y, where="post", color=colour, linestyle=dash)
    axes.plot(x[-1], y[-1], marker, color=colour, markersize=5)
    text = "" if cdf.delivered_ratio >= 0.9995 else f" ({cdf.delivered_ratio:.1%} came)"
    axes.plot([], [], color=colour, linestyle=dash, marker=marker, markersize=5, label=label + text)


def _finish(axes: Axes) -> None:
    axes.set(xlabel="latency, ms", ylabel="share of the published", xscale="log", ylim=(0, 1.03))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    for ratio in (0.5, 0.99):
        axes.axhline(ratio, color=palette.UNKNOWN, linewidth=0.8, linestyle=":", zorder=0.5)


_STEPS = (
    ("probe sent", "o", palette.SERIES[2]),
    ("probe arrives", "^", palette.SERIES[5]),
    ("answer back", "s", palette.SERIES[3]),
    ("fresh message delivered", "*", palette.SERIES[1]),
)


@in_style
def reconnect_waterfall(runs: Sequence[Sequence[Fall]]) -> list[str]:
    """One row per restoration: what came first, and when; the slowest if they are many, in the order of time."""
    width_in = width_of(runs)
    figures: list[Figure | None] = []
    for falls in runs:
        if not falls:
            figures.append(None)
            continue
        slowest = sorted(falls, key=lambda fall: -_end_s(fall))[:_FALLS_MAX]
        shown = sorted(slowest, key=lambda fall: fall.reconnect.restored_ns)
        figure, (axes,) = new_figure(1, 1, height_in=1.15 + 0.3 * len(shown), width_in=width_in)
        _falls(axes, shown, width_in)
        figures.append(figure)
    same_axes([figure.axes[0] for figure in figures if figure is not None], y=False)
    words = "What came first after each restoration, one row per restoration"
    return ["" if figure is None else svg(figure, words) for figure in figures]


def _end_s(fall: Fall) -> float:
    return math.inf if fall.delivery_s is None else fall.delivery_s


def _falls(axes: Axes, falls: Sequence[Fall], width_in: float) -> None:
    known = [time for fall in falls for time in _times(fall) if time is not None]
    most_ms = max(known, default=0.001) * 1e3
    for row, fall in enumerate(falls):
        times = _times(fall)
        last_s = max((time for time in times if time is not None), default=0.0)
        axes.plot([0, last_s * 1e3], [row, row], color=palette.UNKNOWN, linewidth=2.5, solid_capstyle="butt", zorder=1)
        for time, (_, marker, colour) in zip(times, _STEPS, strict=True):
            if time is not None:
                size = 11 if marker == "*" else 6.5
                axes.plot(
                    time * 1e3, row, marker, color=colour, markersize=size, markeredgecolor=palette.PAGE, zorder=3
                )
        text = "nothing fresh came" if fall.delivery_s is None else f"{fall.delivery_s * 1e3:.1f} ms"
        axes.annotate(text, (last_s * 1e3, row), xytext=(9, 0), textcoords="offset points", va="center")
    names = [f"{'–'.join(fall.reconnect.between)} at {fall.reconnect.restored_at_s:.2f} s" for fall in falls]
    axes.set_yticks(range(len(falls)), names)
    axes.set(xlabel="time since the restoration, ms", ylim=(len(falls) - 0.4, -0.6), xlim=(0, 1.2 * most_ms))
    axes.axvline(0, color=palette.INK, linewidth=1.2)
    axes.grid(False, axis="y")
    handles = [
        Line2D([], [], linestyle="", marker=marker, color=colour, markersize=7, label=name)
        for name, marker, colour in _STEPS
    ]
    legend_above(axes, width_in=width_in - 1.6, handles=handles)


def _times(fall: Fall) -> tuple[float | None, ...]:
    return fall.probe_s, fall.heard_s, fall.answer_s, fall.delivery_s
