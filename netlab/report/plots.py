"""The plots of a run over its time and by topic: data in, SVG out. Nothing is worked out here.

Every function draws one figure per run; with two runs the figures are narrower and share their axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from netlab.report import palette
from netlab.report.data import Arrivals, Grid, Points, envelope
from netlab.report.drawing import (
    COLUMNS,
    in_style,
    legend_above,
    look,
    new_figure,
    same_axes,
    svg,
    width_of,
)
from netlab.report.marks import Marks
from netlab.report.words import counted, typeset

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROW_IN = 0.22
_BINS_MAX = 80


@in_style
def intermessage_times(runs: Sequence[Sequence[Arrivals]]) -> list[str]:
    """Histogram and density of the times between receipts, with the fitted normal; one panel per stream."""
    return [_arrivals(found, width_of(runs)) if found else "" for found in runs]


def _arrivals(found: Sequence[Arrivals], width_in: float) -> str:
    columns = min(len(found), 2)
    figure, axes = new_figure(math.ceil(len(found) / columns), columns, height_in=2.7, width_in=width_in)
    for panel, entry in zip(axes, found, strict=False):
        _density(panel, entry)
    return svg(figure, "Histograms of the times between messages with fitted normal distributions")


def _density(axes: Axes, entry: Arrivals) -> None:
    mean, sigma = entry.mean_s, max(entry.sigma_s, entry.interval_s * 1e-4)
    reach = max(5 * sigma, 0.01 * entry.interval_s)
    low, high = mean - reach, mean + reach
    shown = [value for value in entry.intervals_s if low <= value <= high]
    bins = min(round(6 * reach / sigma), _BINS_MAX) | 1  # an odd number: the mean is in the middle of one
    axes.axvspan(mean - sigma, mean + sigma, color=palette.SERIES[1], alpha=0.14, linewidth=0)
    axes.hist(shown, bins=bins, range=(low, high), density=True, color=palette.SERIES[0], alpha=0.6, label="measured")
    at = [low + (high - low) * step / 200 for step in range(201)]
    curve = [math.exp(-(((x - mean) / sigma) ** 2) / 2) / (sigma * math.sqrt(2 * math.pi)) for x in at]
    fitted = f"N({mean:.3f} s, {entry.sigma_s:.3f} s)"
    axes.plot(at, curve, color=palette.SERIES[1], linestyle="--", label=fitted)
    outside = len(entry.intervals_s) - len(shown)
    beyond = f", {outside} beyond" if outside else ""
    gaps = counted(entry.gaps, "gap")
    axes.set_title(f"{typeset(str(entry.stream))}\n{len(entry.intervals_s)} intervals{beyond}, {gaps}", pad=20)
    axes.set(xlabel="time since the message before, s", ylabel="density, 1/s", xlim=(low, high))
    axes.locator_params(axis="x", nbins=5)
    legend_above(axes, width_in=3.0)


@in_style
def data_volumes(runs: Sequence[Mapping[str, Mapping[str, int]]]) -> list[str]:
    """Bars of delivered payload by topic, stacked by publishing node."""
    nodes = sorted({node for found in runs for by_node in found.values() for node in by_node})
    totals = [sum(by_node.values()) for found in runs for by_node in found.values()]
    scale, unit = size_unit(max(totals, default=1))
    figures = [_bars(found, nodes, scale, unit, width_of(runs)) if found else None for found in runs]
    same_axes([figure.axes[0] for figure in figures if figure is not None], y=False)
    words = "Bars of the delivered payload by topic and publishing node"
    return ["" if figure is None else svg(figure, words) for figure in figures]


def _bars(
    found: Mapping[str, Mapping[str, int]], nodes: Sequence[str], scale: float, unit: str, width_in: float
) -> Figure:
    figure, (axes,) = new_figure(1, 1, height_in=1.0 + 0.34 * len(found), width_in=width_in)
    topics = sorted(found, key=lambda topic: sum(found[topic].values()))
    left = [0.0] * len(topics)
    for number, node in enumerate(nodes):
        sizes = [found[topic].get(node, 0) / scale for topic in topics]
        own = look(number)
        axes.barh(topics, sizes, left=left, label=node, color=own.colour, hatch=own.hatch, edgecolor=palette.PAGE)
        left = [a + b for a, b in zip(left, sizes, strict=True)]
    for topic, total in zip(topics, left, strict=True):
        text = size_text(total * scale)
        axes.annotate(text, (total, topic), xytext=(4, 0), textcoords="offset points", va="center")
    axes.set(xlabel=f"delivered payload, {unit}")
    axes.set_xlim(0, 1.15 * max(left))
    axes.grid(False, axis="y")
    legend_above(axes, width_in=width_in - 1)
    return figure


@in_style
def latency_by_priority(runs: Sequence[tuple[Mapping[int, Points], Marks]]) -> list[str]:
    """Latency of every message over time, by priority, on a logarithmic scale, with what happened meanwhile."""
    priorities = sorted({priority for found, _ in runs for priority in found})
    figures = [_latency(found, marks, priorities, width_of(runs)) if found else None for found, marks in runs]
    same_axes([figure.axes[0] for figure in figures if figure is not None])
    words = "Latency of every message over the time of its publication, by priority"
    return ["" if figure is None else svg(figure, words) for figure in figures]


def _latency(found: Mapping[int, Points], marks: Marks, priorities: Sequence[int], width_in: float) -> Figure:
    figure, (axes,) = new_figure(1, 1, height_in=3.5, width_in=width_in)
    for priority, series in reversed(list(found.items())):  # the most urgent on top
        thin = envelope(series, columns=COLUMNS)
        values_ms = [max(value, 1e-6) * 1e3 for value in thin.values]
        own = look(priorities.index(priority))
        axes.plot(
            thin.at_s, values_ms, own.marker, markersize=2.8, color=own.colour, label=f"priority {priority}", alpha=0.85
        )
    axes.set(xlabel="published at, s", ylabel="latency, ms", yscale="log")
    axes.margins(y=0.12)  # room for the number above a ring
    handles = [*reversed(axes.get_legend_handles_labels()[0]), *_mark(axes, marks)]
    for number, at_s, latency_s in marks.worst:
        _ring(axes, number, at_s, max(latency_s, 1e-6) * 1e3)
    legend_above(axes, width_in=width_in - 0.8, handles=handles)
    return figure


def _ring(axes: Axes, number: str, x: float, y: float) -> None:
    """Mark the worst instance of an expectation by the number that it has in their table."""
    axes.plot([x], [y], "o", markersize=9, markerfacecolor="none", markeredgecolor=palette.INK, markeredgewidth=1.4)
    axes.annotate(
        number,
        (x, y),
        xytext=(0, 8),
        textcoords="offset points",
        ha="center",
        fontsize=8,
        fontweight="bold",
        zorder=6,
    )


@in_style
def queue_depths(runs: Sequence[tuple[Mapping[str, Points], Marks]]) -> list[str]:
    """Payload that waits or is under way, by publishing node, over time."""
    nodes = sorted({node for found, _ in runs for node in found})
    most = max((max(series.values) for found, _ in runs for series in found.values()), default=1.0)
    figures = [_queues(found, marks, nodes, most, width_of(runs)) if found else None for found, marks in runs]
    same_axes([figure.axes[0] for figure in figures if figure is not None])
    words = "Payload published and not yet delivered over time, by publishing node"
    return ["" if figure is None else svg(figure, words) for figure in figures]


def _queues(found: Mapping[str, Points], marks: Marks, nodes: Sequence[str], most: float, width_in: float) -> Figure:
    figure, (axes,) = new_figure(1, 1, height_in=3.0, width_in=width_in)
    scale, unit = size_unit(most)
    for node, series in found.items():
        thin, own = envelope(series, columns=COLUMNS), look(nodes.index(node))
        sizes = [value / scale for value in thin.values]
        axes.step(thin.at_s, sizes, where="post", color=own.colour, linestyle=own.dash, label=node)
    handles = [*axes.get_legend_handles_labels()[0], *_mark(axes, marks)]
    axes.set(xlabel="time, s", ylabel=f"payload, {unit}", ylim=(0, None))
    legend_above(axes, width_in=width_in - 0.8, handles=handles)
    return figure


@in_style
def link_quality(
    runs: Sequence[Grid], *, label: str, least: float | None = None, most: float | None = None
) -> list[str]:
    """One row per directed pair of nodes, coloured by a quantity over time; blank where nothing was sent."""
    known = [value for found in runs for row in found.values for value in row if value is not None]
    least = min(known, default=0.0) if least is None else least
    most = max(known, default=1.0) if most is None else most
    return [_heat(found, label, least, most, width_of(runs)) if found.rows else "" for found in runs]


def _heat(found: Grid, label: str, least: float, most: float, width_in: float) -> str:
    height_in = max(1.0 + _ROW_IN * len(found.rows), 2.4)
    figure, (axes,) = new_figure(1, 1, height_in=height_in, width_in=width_in)
    values = [[math.nan if value is None else value for value in row] for row in found.values]
    end_s = found.start_s + found.column_s * len(found.values[0])
    extent = (found.start_s, end_s, len(found.rows) - 0.5, -0.5)
    image = axes.imshow(
        values, aspect="auto", interpolation="nearest", extent=extent, cmap="cividis", vmin=least, vmax=most
    )
    axes.set_yticks(range(len(found.rows)), found.rows)
    axes.set(xlabel="time, s")
    axes.grid(False)
    figure.colorbar(image, ax=axes, label=label, pad=0.015, fraction=0.03, aspect=max(20, 7 * height_in))
    return svg(figure, f"{label.partition(',')[0].capitalize()} over time, one row per directed pair of nodes")


def size_unit(most: float) -> tuple[float, str]:
    """A divisor and its unit, so that ``most`` bytes are a number of few digits."""
    return next(((scale, unit) for scale, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")) if most >= scale), (1, "B"))


def size_text(size_bytes: float) -> str:
    """A size for a person."""
    scale, unit = size_unit(size_bytes)
    return f"{size_bytes / scale:.3g} {unit}"


def _mark(axes: Axes, marks: Marks) -> list[Line2D | Patch]:
    """Draw what was done to the lab, and when links were down; returns the keys to it."""
    handles: list[Line2D | Patch] = []
    for at_s in marks.acts_s:
        axes.axvline(at_s, color=palette.UNKNOWN, linestyle=":", linewidth=1.3, zorder=0.5)
    if marks.acts_s:
        handles.append(Line2D([], [], color=palette.UNKNOWN, linestyle=":", label="act on the lab"))
    for start_s, end_s in marks.down_s:
        axes.axvspan(start_s, end_s, facecolor="none", edgecolor=palette.FAINT, hatch="///", linewidth=0, zorder=0.2)
    if marks.down_s:
        patch = Patch(facecolor="none", edgecolor=palette.UNKNOWN, hatch="///", linewidth=0, label="link down")
        handles.append(patch)
    return handles
