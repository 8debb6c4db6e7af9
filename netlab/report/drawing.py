"""How plots look: one style, figures of a given width, legends above them, the same axes side by side, SVG."""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from netlab.report import palette

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

_METADATA = re.compile(r"\s*<metadata>.*?</metadata>", re.DOTALL)
_P = ParamSpec("_P")
_R = TypeVar("_R")
WIDTH_IN = 8.6
NARROW_IN = 6.4  # one of two side by side
COLUMNS = 400  # of a long series: what a plot of this width can show
_SHORT_AXIS = 300.0
_LEGEND_POINT, _HANDLE_EM, _GAP_EM, _CHARACTER_EM = 8.5, 2.4, 1.4, 0.58
# Each release of matplotlib has another type for this.
_STYLE: Any = {
    "svg.fonttype": "none",  # text stays text: small, and in the page's own font
    "svg.hashsalt": "netlab",
    "font.size": 9.0,
    "text.color": palette.INK,
    "axes.edgecolor": palette.UNKNOWN,
    "axes.labelcolor": palette.INK,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": palette.FAINT,
    "grid.linewidth": 0.8,
    "xtick.color": palette.UNKNOWN,
    "ytick.color": palette.UNKNOWN,
    "xtick.labelcolor": palette.INK,
    "ytick.labelcolor": palette.INK,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "legend.frameon": False,
    "legend.fontsize": _LEGEND_POINT,
    "lines.linewidth": 1.5,
    "hatch.linewidth": 0.6,
}


@dataclass(frozen=True, slots=True)
class Look:
    """How one series is told from the others: by colour, and by dash, marker or hatch as well."""

    colour: str
    dash: Any
    marker: str
    hatch: str


def look(number: int) -> Look:
    """The look of the series ``number`` of a plot; after seven the colours begin again with other dashes."""
    turn = number // len(palette.SERIES)
    return Look(
        palette.SERIES[number % len(palette.SERIES)],
        palette.DASHES[(number + turn) % len(palette.DASHES)],
        palette.MARKERS[(number + turn) % len(palette.MARKERS)],
        palette.HATCHES[(turn + number) % len(palette.HATCHES)],
    )


def in_style(draw: Callable[_P, _R]) -> Callable[_P, _R]:
    """Colours and sizes are taken when a part of a plot is made."""

    @functools.wraps(draw)
    def drawn(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with matplotlib.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return drawn


def width_of(runs: Sequence[object]) -> float:
    """How wide the figure of each run is, in inches."""
    return WIDTH_IN if len(runs) == 1 else NARROW_IN


def new_figure(rows: int, columns: int, *, height_in: float, width_in: float = WIDTH_IN) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, row by row; ``height_in`` is that of one row."""
    figure = Figure(figsize=(width_in, height_in * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    return figure, [panel for row in axes for panel in row]


def legend_above(axes: Axes, *, width_in: float, handles: Sequence[Any] | None = None) -> None:
    """Put the legend between title and plot, where it hides nothing, in lines of at most ``width_in``."""
    shown = list(handles) if handles is not None else axes.get_legend_handles_labels()[0]
    if shown:
        columns = columns_that_fit([str(handle.get_label()) for handle in shown], width_in)
        place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
        axes.legend(handles=shown, **place, **legend_row(columns))


def legend_row(columns: int) -> dict[str, Any]:
    """How wide the parts of a legend of so many columns are."""
    return {"ncols": columns, "handlelength": _HANDLE_EM, "columnspacing": _GAP_EM}


def columns_that_fit(names: Sequence[str], width_in: float) -> int:
    """How many columns the keys of a legend can have in a width; the first columns are the longer ones."""
    for columns in range(len(names), 1, -1):
        rows, longer = divmod(len(names), columns)
        ends = [rows * column + min(column, longer) for column in range(columns + 1)]
        widest = [max(map(len, names[start:end])) for start, end in pairwise(ends)]
        points = sum(_LEGEND_POINT * (_HANDLE_EM + 1.0 + _GAP_EM + _CHARACTER_EM * width) for width in widest)
        if points <= 72 * width_in:
            return columns
    return 1


def same_axes(panels: Sequence[Axes], *, x: bool = True, y: bool = True) -> None:
    """Give panels that are compared the same limits, and label logarithmic axes with plain numbers."""
    for wanted, name in ((x, "xlim"), (y, "ylim")):
        if wanted and len(panels) > 1:
            limits = [getattr(panel, f"get_{name}")() for panel in panels]
            for panel in panels:
                getattr(panel, f"set_{name}")(min(low for low, _ in limits), max(high for _, high in limits))
    for axis in (axis for panel in panels for axis in (panel.xaxis, panel.yaxis)):
        if axis.get_scale() == "log":
            _label_plainly(axis)


def _label_plainly(axis: Axis) -> None:
    """Powers of ten as numbers, and 2 and 5 of them where the axis is short."""
    low, high = axis.get_view_interval()
    is_short = high / max(low, 1e-12) < _SHORT_AXIS
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if is_short else (1.0,), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def svg(figure: Figure, description: str) -> str:
    """Return a figure as SVG in the page's colours; ``description`` is for those who cannot see it."""
    for unused in (axes for axes in figure.axes if not axes.has_data()):
        unused.set_visible(False)
    text = io.StringIO()
    figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    whole = text.getvalue()
    whole = _METADATA.sub("", whole)
    head = f'<svg role="img" aria-label="{description}"'
    return palette.with_variables(whole[whole.index("<svg") :].replace("<svg", head, 1))
