"""The map: tunnels, links by quality, nodes with their names. One widget, drawn row by row.

The rock is drawn once per size; everything else only when a node has moved by a dot or something else has changed; a
row is made into text only when its cells have changed.
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import groupby

from rich.style import Style
from textual import events
from textual.geometry import Region, Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from netlab.live.model import LiveModel, Tunnel
from netlab.tui import palette
from netlab.tui.braille import DOTS_X, DOTS_Y, Layer, characters
from netlab.tui.map_labels import Labels, labels_of
from netlab.tui.map_rows import row_segments
from netlab.tui.projection import Bounds, Point, fit
from netlab.tui.rock import draw_rock
from netlab.tui.scene import Chosen, Scene, places

_LEAST_COLUMNS, _LEAST_ROWS = 8, 4


class MapView(Widget, can_focus=True):
    """Shows a model's nodes where they are. Posts :class:`Picked` for clicks.

    Attributes:
        chosen: What the person has picked.
        target_m: Where a move would lead, while one is being made.
        projection: From metres to dots.
    """

    DEFAULT_CSS = "MapView { background: #12161c; }"

    class Picked(Message):
        """A node (its name), a link (its two names) or a place (metres) was clicked."""

        def __init__(self, chosen: Chosen, place_m: Point) -> None:
            super().__init__()
            self.chosen = chosen
            self.place_m = place_m

    def __init__(self, model: LiveModel, *, relays: Collection[str] = (), id: str | None = None) -> None:
        super().__init__(id=id)
        self.model = model
        self.chosen: Chosen = None
        self.target_m: Point | None = None
        self.projection = fit(Bounds.of([]), 1, 1)
        self._relays = relays
        self._fitted: tuple[Size, tuple[Tunnel, ...], Bounds] | None = None
        self._rock, self._floor = draw_rock([], self.projection, 0, 0)
        self._scene: Scene | None = None
        self._layer = Layer(0, 0)
        self._labels: Labels = {}
        self._strips: dict[int, Strip] = {}

    def update_map(self) -> None:
        """Draw what has changed since the last time."""
        if self.size.width < _LEAST_COLUMNS or self.size.height < _LEAST_ROWS:
            return
        self._fit()
        scene = Scene.of(self.model, self.projection, chosen=self.chosen, target_m=self.target_m)
        if scene == self._scene:
            return
        self._scene = scene
        layer = self._rock.copy()
        layer.draw(scene.lines())
        labels = labels_of(scene, *self.size, relays=self._relays)
        self._show(layer, labels)

    def _show(self, layer: Layer, labels: Labels) -> None:
        """Take over what has been drawn; rows that look as before stay."""
        old, self._layer = self._layer, layer
        written, self._labels = self._labels, labels
        if old.size != layer.size:
            self._strips.clear()
            self.refresh()
            return
        redrawn = ((old.masks != layer.masks) | (old.inks != layer.inks)).any(axis=1).tolist()
        changed = [row for row, drawn in enumerate(redrawn) if drawn or written.get(row) != labels.get(row)]
        for row in changed:
            self._strips.pop(row, None)
        for _, run in groupby(enumerate(changed), key=lambda placed: placed[1] - placed[0]):  # rows in a row
            rows = [row for _, row in run]
            self.refresh(Region(0, rows[0], self.size.width, len(rows)))

    def render_line(self, y: int) -> Strip:
        """One row; made only when its cells have changed."""
        if y >= self._layer.size[1]:
            return Strip.blank(self.size.width, Style(bgcolor=palette.GROUND))
        strip = self._strips.get(y)
        if strip is None:
            inks, floor = self._layer.inks[y].tolist(), self._floor[y].tolist()
            segments = row_segments(characters(self._layer.masks[y]), inks, floor, self._labels.get(y, {}))
            strip = self._strips[y] = Strip(list(segments), self._layer.size[0])
        return strip

    @property
    def cell_m(self) -> Point:
        """How wide and high a cell is, metres."""
        return DOTS_X / self.projection.dots_per_m, DOTS_Y / self.projection.dots_per_m

    def _fit(self) -> None:
        """Have everything in sight; who walks on must not make the map tremble, so that it keeps what it has shown."""
        tunnels = self.model.tunnels
        wanted = Bounds.of([*(point for tunnel in tunnels for point in tunnel.path_m), *places(self.model).values()])
        if self._fitted is not None and self._fitted[:2] == (self.size, tunnels):
            shown = self._fitted[2]
            if shown.holds(wanted):
                return
            wanted = shown.widened(wanted)
        self._fitted = (self.size, tunnels, wanted)
        self.projection = fit(wanted, *self.size)
        self._rock, self._floor = draw_rock(tunnels, self.projection, *self.size)
        self._strips.clear()
        self.refresh()

    def on_click(self, event: events.Click) -> None:
        """Say what was clicked: a node before a link before a bare place."""
        scene = Scene.of(self.model, self.projection, chosen=self.chosen, target_m=self.target_m)
        self.post_message(self.Picked(scene.at(event.x, event.y), self.projection.place(event.x, event.y)))
