"""The map of a run: tunnels, and every node's path by whether it was connected. Data in, SVG out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from netlab.report import palette
from netlab.report.data import Contact, thinned_path
from netlab.report.drawing import in_style, legend_above, new_figure, svg, width_of
from netlab.report.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DASH: dict[str, Literal["-", ":", "--"]] = {palette.GOOD: "-", palette.BAD: ":", palette.UNKNOWN: "--"}
_CONTACT = {palette.GOOD: "connected", palette.BAD: "not connected", palette.UNKNOWN: "no traffic with the base"}


@in_style
def tunnel_maps(runs: Sequence[tuple[Scene, Mapping[str, Contact], str | None]]) -> list[str]:
    """Tunnels, and every node's path by whether it was connected to the base; scenes without places are blank."""
    figures = [_map(*run, width_of(runs)) if run[0].paths else None for run in runs]
    words = "Map of the tunnels with every node's path, by whether it was connected"
    return ["" if figure is None else svg(figure, words) for figure in figures]


def _map(scene: Scene, contacts: Mapping[str, Contact], base: str | None, width_in: float) -> Figure:
    figure, (axes,) = new_figure(1, 1, height_in=_map_height_in(scene, width_in), width_in=width_in)
    for places in scene.tunnels.values():
        axes.plot(*zip(*places, strict=True), color=palette.FAINT, linewidth=8, solid_capstyle="round", zorder=1)
    shown = set()
    for node, path in scene.paths.items():
        shown |= _path(axes, path, contacts.get(node))
        _, x, y = path[-1]
        is_base, is_still = node == base, len({place[1:] for place in path}) == 1
        marker, size = ("*", 13) if is_base else ("s", 4) if is_still else ("o", 6)
        colour = palette.SERIES[1] if is_base else palette.INK
        axes.plot(x, y, marker=marker, markersize=size, color=colour, markeredgecolor=palette.PAGE, zorder=4)
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    axes.set_adjustable("datalim")
    axes.margins(0.08)
    handles = [
        Line2D([], [], color=colour, linestyle=_DASH[colour], linewidth=2.2, label=name)
        for colour, name in _CONTACT.items()
        if colour in shown
    ]
    legend_above(axes, width_in=width_in - 1, handles=handles)
    _name_nodes(figure, axes, scene)
    return figure


def _map_height_in(scene: Scene, width_in: float) -> float:
    """As the places ask for, but no ribbon and no tower."""
    places = [place for places in scene.tunnels.values() for place in places]
    places += [(x, y) for path in scene.paths.values() for _, x, y in path]
    xs, ys = zip(*places, strict=True)
    ratio: float = (max(ys) - min(ys)) / max(max(xs) - min(xs), 1.0)
    return width_in * min(max(ratio, 0.28), 0.58) + 0.9


_SPOTS = ((6, 5), (-6, 5), (6, -12), (-6, -12), (0, 9), (0, -17), (14, 14), (-14, 14), (14, -22), (-14, -22))


def _name_nodes(figure: Figure, axes: Axes, scene: Scene) -> None:
    """A name beside each last place, where no other name is yet."""
    figure.draw_without_rendering()  # only then it is known how many points a metre is
    taken: list[tuple[float, float, float, float]] = []
    for node, path in scene.paths.items():
        _, x, y = path[-1]
        at = axes.transData.transform((x, y)) * 72 / figure.get_dpi()
        width = 5.0 * len(node)
        for dx, dy in _SPOTS:
            left = at[0] + dx - (0 if dx > 0 else width if dx < 0 else width / 2)
            box = (left, at[1] + dy, left + width, at[1] + dy + 9)
            if not any(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken):
                break
        taken.append(box)
        side: Literal["left", "right", "center"] = "left" if dx > 0 else "right" if dx < 0 else "center"
        axes.annotate(node, (x, y), xytext=(dx, dy), textcoords="offset points", ha=side, zorder=5, fontsize=8.5)


def _path(axes: Axes, path: Sequence[tuple[float, float, float]], contact: Contact | None) -> set[str]:
    """Draw a path in pieces of one state each, a piece begins where the one before ends; returns the colours."""
    piece: list[tuple[float, float]] = []
    colour, used = "", set()
    for at_s, x, y in path:
        known = contact is not None and contact.is_known
        now = palette.UNKNOWN if not known else palette.GOOD if contact and contact.at(at_s) else palette.BAD
        if now != colour and piece:
            _piece(axes, [*piece, (x, y)], colour)
            piece = []
        colour = now
        used.add(now)
        piece.append((x, y))
    _piece(axes, piece, colour)
    return used if len({place[1:] for place in path}) > 1 else set()


def _piece(axes: Axes, places: Sequence[tuple[float, float]], colour: str) -> None:
    order = 3.5 if colour == palette.BAD else 3.0  # seen also where the node came back the same way, connected
    width = 3.5 if colour == palette.BAD else 2.0
    xs, ys = zip(*thinned_path(places), strict=True)
    axes.plot(xs, ys, color=colour, linestyle=_DASH[colour], linewidth=width, zorder=order)
