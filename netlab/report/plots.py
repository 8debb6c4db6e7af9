"""The plots of a report: data in, SVG out. Nothing is worked out here."""

from __future__ import annotations

import functools
import io
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, ParamSpec

import matplotlib
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from netlab.report import palette
from netlab.report.data import Arrivals, Contact, Grid, Points, envelope
from netlab.report.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_P = ParamSpec("_P")
_WIDTH_IN = 8.5
_COLUMNS = 400
_ROW_IN = 0.22
# Each release of matplotlib has another type for this.
_STYLE: Any = {
    "svg.fonttype": "none",  # text stays text: small, and in the page's own font
    "svg.hashsalt": "netlab",
    "font.size": 9.0,
    "text.color": palette.INK,
    "axes.edgecolor": palette.INK,
    "axes.labelcolor": palette.INK,
    "axes.titlesize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": palette.FAINT,
    "xtick.color": palette.INK,
    "ytick.color": palette.INK,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "legend.frameon": False,
    "lines.linewidth": 1.3,
}


def _in_style(draw: Callable[_P, str]) -> Callable[_P, str]:
    """Colours and sizes are taken when a part of a plot is made."""

    @functools.wraps(draw)
    def drawn(*args: _P.args, **kwargs: _P.kwargs) -> str:
        with matplotlib.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return drawn


@_in_style
def intermessage_times(found: Sequence[Arrivals]) -> str:
    """Histogram and density of the times between receipts, with the fitted normal; one panel per stream."""
    columns = min(len(found), 2)
    figure, axes = _figure(math.ceil(len(found) / columns), columns, height_in=2.6)
    for panel, entry in zip(axes, found, strict=False):
        _density(panel, entry)
    return _svg(figure)


def _density(axes: Axes, entry: Arrivals) -> None:
    mean, sigma = entry.mean_s, max(entry.sigma_s, entry.interval_s * 1e-4)
    reach = max(4 * sigma, 0.05 * entry.interval_s)
    low, high = mean - reach, mean + reach
    shown = [value for value in entry.intervals_s if low <= value <= high]
    bins = min(max(round(math.sqrt(len(shown))), 10), 60) | 1  # an odd number: the mean is in the middle of one
    axes.hist(shown, bins=bins, range=(low, high), density=True, color=palette.SERIES[0], alpha=0.55, label="measured")
    at = [low + (high - low) * step / 200 for step in range(201)]
    curve = [math.exp(-(((x - mean) / sigma) ** 2) / 2) / (sigma * math.sqrt(2 * math.pi)) for x in at]
    axes.plot(at, curve, color=palette.SERIES[1], label=f"N({mean:.3f} s, {entry.sigma_s:.3f} s)")
    axes.axvspan(mean - sigma, mean + sigma, color=palette.SERIES[1], alpha=0.14, linewidth=0)
    outside = len(entry.intervals_s) - len(shown)
    beyond = f", {outside} beyond" if outside else ""
    axes.set_title(
        f"{entry.stream}\n{len(entry.intervals_s)} intervals{beyond}, {entry.gaps} gap{'s' * (entry.gaps != 1)}"
    )
    axes.set(xlabel="time since the message before, s", ylabel="density, 1/s", xlim=(low, high))
    axes.legend(fontsize=8)


@_in_style
def tunnel_map(scene: Scene, contacts: Mapping[str, Contact]) -> str:
    """Tunnels, and every node's path by whether it was connected to the base."""
    figure, (axes,) = _figure(1, 1, height_in=4.6)
    for places in scene.tunnels.values():
        axes.plot(*zip(*places, strict=True), color=palette.FAINT, linewidth=7, solid_capstyle="round", zorder=1)
    for node, path in scene.paths.items():
        _path(axes, path, contacts.get(node))
        _, x, y = path[-1]
        axes.plot(x, y, marker="o", markersize=5, color=palette.INK, zorder=4)
        axes.annotate(node, (x, y), xytext=(5, 5), textcoords="offset points", zorder=5)
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    axes.set_adjustable("datalim")
    axes.margins(0.08)
    names = {"connected": palette.GOOD, "not connected": palette.BAD, "no traffic with the base": palette.UNKNOWN}
    handles = [Line2D([], [], color=colour, linestyle=_DASH[colour], label=name) for name, colour in names.items()]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.12), ncols=3)
    return _svg(figure)


_DASH: dict[str, Literal["-", ":", "--"]] = {palette.GOOD: "-", palette.BAD: ":", palette.UNKNOWN: "--"}


def _path(axes: Axes, path: Sequence[tuple[float, float, float]], contact: Contact | None) -> None:
    """Draw a path in pieces of one state each; a piece begins where the one before ends."""
    piece: list[tuple[float, float]] = []
    colour = ""
    for at_s, x, y in path:
        known = contact is not None and contact.is_known
        now = palette.UNKNOWN if not known else palette.GOOD if contact and contact.at(at_s) else palette.BAD
        if now != colour and piece:
            _piece(axes, [*piece, (x, y)], colour)
            piece = []
        colour = now
        piece.append((x, y))
    _piece(axes, piece, colour)


def _piece(axes: Axes, places: Sequence[tuple[float, float]], colour: str) -> None:
    step = max(len(places) // _COLUMNS, 1)
    thinned = [*places[::step], places[-1]]
    order = 3.5 if colour == palette.BAD else 3.0  # seen also where the node came back the same way, connected
    width = 3.5 if colour == palette.BAD else 2.0
    axes.plot(*zip(*thinned, strict=True), color=colour, linestyle=_DASH[colour], linewidth=width, zorder=order)


@_in_style
def data_volumes(found: Mapping[str, Mapping[str, int]]) -> str:
    """Bars of delivered payload by topic, stacked by publishing node."""
    figure, (axes,) = _figure(1, 1, height_in=0.9 + 0.36 * len(found))
    topics = sorted(found, key=lambda topic: sum(found[topic].values()))
    nodes = sorted({node for by_node in found.values() for node in by_node})
    scale, unit = _unit(max(sum(by_node.values()) for by_node in found.values()))
    left = [0.0] * len(topics)
    for number, node in enumerate(nodes):
        sizes = [found[topic].get(node, 0) / scale for topic in topics]
        colour = palette.SERIES[number % len(palette.SERIES)]
        hatch = ("", "////", "....", "xxxx")[number // len(palette.SERIES) % 4]
        axes.barh(topics, sizes, left=left, label=node, color=colour, hatch=hatch, edgecolor=palette.PAGE)
        left = [a + b for a, b in zip(left, sizes, strict=True)]
    for topic, total in zip(topics, left, strict=True):
        own_scale, own_unit = _unit(total * scale)
        text = f"{total * scale / own_scale:.3g} {own_unit}"
        axes.annotate(text, (total, topic), xytext=(4, 0), textcoords="offset points", va="center")
    axes.set(xlabel=f"delivered payload, {unit}")
    axes.set_xlim(0, 1.15 * max(left))
    axes.grid(False, axis="y")
    _legend_beside(axes)
    return _svg(figure)


@_in_style
def latency_by_priority(found: Mapping[int, Points], acts_s: Sequence[float]) -> str:
    """Latency of every message over time, coloured by priority, on a logarithmic scale; lines at ``acts_s``."""
    figure, (axes,) = _figure(1, 1, height_in=3.2)
    for number, (priority, series) in enumerate(found.items()):
        thin = envelope(series, columns=_COLUMNS)
        values_ms = [max(value, 1e-6) * 1e3 for value in thin.values]
        marker = "os^Dv*P"[number % 7]
        colour = palette.SERIES[number % len(palette.SERIES)]
        axes.plot(thin.at_s, values_ms, marker, markersize=2.5, color=colour, label=f"priority {priority}")
    _mark(axes, acts_s)
    axes.set(xlabel="published at, s", ylabel="latency, ms", yscale="log")
    _legend_beside(axes)
    return _svg(figure)


@_in_style
def queue_depths(found: Mapping[str, Points], acts_s: Sequence[float]) -> str:
    """Payload that waits or is under way, by publishing node, over time; lines at ``acts_s``."""
    figure, (axes,) = _figure(1, 1, height_in=3.0)
    scale, unit = _unit(max(max(series.values) for series in found.values()))
    for number, (node, series) in enumerate(found.items()):
        thin = envelope(series, columns=_COLUMNS)
        colour, dash = palette.SERIES[number % len(palette.SERIES)], palette.DASHES[number // len(palette.SERIES) % 4]
        sizes = [value / scale for value in thin.values]
        axes.step(thin.at_s, sizes, where="post", color=colour, linestyle=dash, label=node)
    _mark(axes, acts_s)
    axes.set(xlabel="time, s", ylabel=f"payload, {unit}", ylim=(0, None))
    _legend_beside(axes)
    return _svg(figure)


@_in_style
def link_quality(found: Grid, *, label: str, least: float | None = None, most: float | None = None) -> str:
    """One row per directed pair of nodes, coloured by a quantity over time; blank where nothing was sent."""
    figure, (axes,) = _figure(1, 1, height_in=max(1.0 + _ROW_IN * len(found.rows), 2.2))
    values = [[math.nan if value is None else value for value in row] for row in found.values]
    end_s = found.start_s + found.column_s * len(found.values[0])
    extent = (found.start_s, end_s, len(found.rows) - 0.5, -0.5)
    image = axes.imshow(
        values, aspect="auto", interpolation="nearest", extent=extent, cmap="cividis", vmin=least, vmax=most
    )
    axes.set_yticks(range(len(found.rows)), found.rows)
    axes.set(xlabel="time, s")
    axes.grid(False)
    figure.colorbar(image, ax=axes, label=label, pad=0.02)
    return _svg(figure)


def _unit(most: float) -> tuple[float, str]:
    """A divisor and its unit, so that ``most`` bytes are a number of few digits."""
    return next(((scale, unit) for scale, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")) if most >= scale), (1, "B"))


def _mark(axes: Axes, acts_s: Sequence[float]) -> None:
    for at_s in acts_s:
        axes.axvline(at_s, color=palette.UNKNOWN, linestyle=":", linewidth=1.4, zorder=0.5)


def _legend_beside(axes: Axes) -> None:
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)


def _figure(rows: int, columns: int, *, height_in: float) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(_WIDTH_IN, height_in * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    flat = [panel for row in axes for panel in row]
    return figure, flat


def _svg(figure: Figure) -> str:
    for unused in (axes for axes in figure.axes if not axes.has_data()):
        unused.set_visible(False)
    text = io.StringIO()
    figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    whole = text.getvalue()
    return palette.with_variables(whole[whole.index("<svg") :])
