"""One lab on one screen, to look and to point at: layout, what is drawn when, what is chosen, the tour."""

from __future__ import annotations

import asyncio

from rich.text import Text
from textual import work
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.screen import Screen
from textual.widgets import Static

from netlab.errors import NetlabError
from netlab.live.links import Grade
from netlab.live.model import LiveModel
from netlab.tui import offers, palette, panels
from netlab.tui.key_bar import KeyBar
from netlab.tui.map_view import MapView
from netlab.tui.projection import Point
from netlab.tui.scene import Chosen
from netlab.tui.session import Session, Verdict
from netlab.tui.standing import Standing
from netlab.tui.tour import Deed, Tour

_STATUS_EVERY_S = 0.5
_PANELS_EVERY_S = 1.0
_TITLES = {"map": "map", "streams": "latency by priority", "timeline": "timeline"}
_LEGEND = (Grade.GOOD, Grade.FAIR, Grade.POOR, Grade.DOWN)


class WatchScreen(Screen[None]):
    """Shows a lab, and changes nothing of it.

    Attributes:
        model: The lab as its records show it.
        standing: The lab as its supervisor describes it.
        verdict: How the run went, once it is over.
        tour: Where the person is in the tour, None outside it.
    """

    def __init__(self, session: Session, *, rate_hz: float) -> None:
        """``rate_hz``: how often the map is drawn."""
        super().__init__()
        self.session = session
        self.model = LiveModel()
        self.standing = Standing()
        self.verdict: Verdict | None = None
        self.tour: Tour | None = None
        self._rate_hz = rate_hz

    def compose(self) -> ComposeResult:
        """Lay it out."""
        yield Static("", id="head")
        with Horizontal(id="above"):
            yield MapView(self.model, relays=self.session.carriers, id="map")
            yield Static("", id="detail")
        with Horizontal(id="below"):
            yield Static("", id="streams")
            yield Static("", id="timeline")
        yield Static("", id="tour")
        yield Static("", id="said")
        yield KeyBar(id="keys")

    def on_mount(self) -> None:
        """Begin to look."""
        self.map.focus()
        for name, title in _TITLES.items():
            self.query_one(f"#{name}").border_title = title
        self.query_one("#tour").border_subtitle = "Enter skips, ? leaves the tour"
        self.map.border_subtitle = "  ".join(f"[{palette.GRADES[g]}]{palette.SIGNS[g]}[/] {g}" for g in _LEGEND)
        self.set_interval(1 / self._rate_hz, self._look)
        self.set_interval(_PANELS_EVERY_S, self._draw_panels)
        self._watch_status()

    @property
    def map(self) -> MapView:
        """The map."""
        return self.query_one(MapView)

    # -- drawing --------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Take in what has been recorded, and draw the map."""
        self.model.describe(self.session.metadata())
        for record in self.session.records():
            self.model.take(record)
        if self.map.chosen is None and self.model.nodes and not self.standing.t_s:
            self._draw_panels()
        self.map.update_map()

    def _draw_panels(self) -> None:
        self._draw("head", panels.head_text(self.model, self.standing, self.size.width))
        for name in ("detail", "streams", "timeline"):
            size = self.query_one(f"#{name}").content_size
            if size.width > 0:
                self._draw(name, self._panel(name, size.width, size.height))

    def _draw(self, name: str, text: Text) -> None:
        self.query_one(f"#{name}", Static).update(text, layout=False)  # no text changes the size of its panel

    def _panel(self, name: str, width: int, lines: int) -> Text:
        match name:
            case "streams":
                return panels.streams_text(self.model, width=width, lines=lines)
            case "timeline":
                return panels.timeline_text(self.model, self.standing, width=width, lines=lines)
        title, text = self._detail(width, lines)
        self.query_one(f"#{name}").border_title = title
        return text

    def _detail(self, width: int, lines: int) -> tuple[str, Text]:
        """What is told of the chosen one, or of the whole lab: (title, text)."""
        chosen = self.map.chosen
        if isinstance(chosen, frozenset) and chosen in self.model.links:
            return "link", panels.link_text(self.model.links[chosen])
        if isinstance(chosen, str) and chosen in self.model.nodes:
            return "node", panels.node_text(self.model.nodes[chosen], self.standing, width=width, lines=lines)
        if self.verdict is not None:
            return "result", panels.verdict_text(self.verdict.brief, width=width)
        return "team", panels.overview_text(self.model, self.standing, width=width)

    def _say(self, text: str, *, bad: bool = False) -> None:
        first = text.splitlines()[0] if text else ""
        said = Text(first, style=palette.WARNING if bad else palette.TEXT)
        self.query_one("#said", Static).update(said)  # a long text takes a second line

    @work(exclusive=True, group="status")
    async def _watch_status(self) -> None:
        """Ask the supervisor now and then, until the scenario is judged."""
        while True:
            try:
                self.standing = Standing.of(await asyncio.to_thread(self.session.status))
            except NetlabError as error:
                self._say(str(error), bad=True)
            if self.standing.phase == "finished":
                break
            await asyncio.sleep(_STATUS_EVERY_S)
        self.verdict = await asyncio.to_thread(self.session.judge)
        self._aim(None)
        self._choose(None)
        self._say("The scenario is over; its result is on the right. q prints the report.")

    # -- choosing -------------------------------------------------------------------------------------------------

    def action_node(self, step: int) -> None:
        """Go to the next node; while a robot is being moved, its target goes aside."""
        if self.map.target_m is None:
            self._pick(offers.next_node(self.model, self.map.chosen, step))
        else:
            self._shift(step, 0)

    def action_link(self, step: int) -> None:
        """Go to the next link; while a robot is being moved, its target goes up or down."""
        if self.map.target_m is None:
            self._pick(offers.next_link(self.model, self.map.chosen, step))
        else:
            self._shift(0, -step)

    def on_map_view_picked(self, event: MapView.Picked) -> None:
        """A click: choose what was clicked, or say where a robot shall go."""
        if self.map.target_m is None:
            self._pick(event.chosen)
        else:
            self._aim(event.place_m)

    def action_back(self) -> None:
        """Leave the move, the tour, the choice: one at a time."""
        if self.map.target_m is not None:
            self._aim(None)
            self._say("")
        elif self.tour is not None:
            self.tour = None
            self._draw_tour()
        else:
            self._choose(None)

    def _shift(self, right: int, up: int) -> None:
        assert self.map.target_m is not None
        (across, down), (x, y) = self.map.cell_m, self.map.target_m
        self._aim((x + right * across, y + up * down))

    def _aim(self, target_m: Point | None) -> None:
        self.map.target_m = target_m
        self.map.update_map()

    def _pick(self, picked: Chosen) -> None:
        """Choose what the person has picked, if that is anything."""
        if picked is not None:
            self._choose(picked)
            self._saw(Deed.LINK if isinstance(picked, frozenset) else Deed.NODE)

    def _choose(self, chosen: Chosen) -> None:
        self.map.chosen = chosen
        self.map.update_map()
        self._draw_panels()

    # -- the tour -------------------------------------------------------------------------------------------------

    def action_tour(self) -> None:
        """Begin the tour, or leave it."""
        self.tour = Tour() if self.tour is None else None
        self._draw_tour()

    def _saw(self, deed: Deed) -> None:
        if self.tour is not None and self.tour.saw(deed):
            self._draw_tour()

    def _draw_tour(self) -> None:
        step = self.tour.step if self.tour is not None else None
        self.set_class(step is not None, "touring")
        if self.tour is None or step is None:
            self.tour = None
            return
        self.query_one("#tour", Static).update(panels.tour_text(step.title, step.text, self.tour.place))
