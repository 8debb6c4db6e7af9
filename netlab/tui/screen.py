"""The main screen: layout, keys, and what each of them does to the lab."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from rich.text import Text
from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.screen import Screen
from textual.widgets import Static

from netlab.errors import NetlabError
from netlab.lab.programs import SINK, SOURCE
from netlab.live.links import Grade
from netlab.live.model import LiveModel
from netlab.scenario.quantities import DURATION
from netlab.tui import palette, panels
from netlab.tui.dialogs import Choice, Field, Form
from netlab.tui.key_bar import KeyBar
from netlab.tui.map_view import MapView
from netlab.tui.panels import Standing
from netlab.tui.session import Session, short
from netlab.tui.tour import Deed, Tour

_STATUS_EVERY_S = 0.5
_WALK_MPS = 1.5


class MainScreen(Screen[None]):
    """One lab on one screen."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("right", "node(1)", "node", key_display="←→"),
        Binding("left", "node(-1)", "node", show=False),
        Binding("down", "link(1)", "link", key_display="↑↓"),
        Binding("up", "link(-1)", "link", show=False),
        Binding("c", "cut", "cut"),
        Binding("f", "flap", "flap"),
        Binding("d", "degrade", "degrade"),
        Binding("m", "move", "move"),
        Binding("p", "deploy", "place relay"),
        Binding("x", "kill", "kill"),
        Binding("r", "restart", "restart"),
        Binding("s", "shell", "shell"),
        Binding("space", "hold", "hold", key_display="space"),
        Binding("full_stop", "step", "step", key_display="."),
        Binding("b", "mark", "mark"),
        Binding("o", "record", "record"),
        Binding("u", "undo", "undo"),
        Binding("w", "save", "save"),
        Binding("question_mark", "tour", "tour", key_display="?"),
        Binding("q", "app.quit", "quit"),
        Binding("enter", "enter", "go", show=False),
        Binding("g", "walk", "walk there", show=False),
        Binding("escape", "back", "back", show=False),
    ]

    def __init__(self, session: Session, *, captures: Path, rate_hz: float) -> None:
        """``captures``: where further recordings and saved scenarios go."""
        super().__init__()
        self.session = session
        self.model = LiveModel()
        self.standing = Standing()
        self.tour: Tour | None = None
        self._captures = captures
        self._rate_hz = rate_hz
        #: The report, once the scenario is over.
        self.verdict = ""

    # -- layout and drawing ---------------------------------------------------------------------------------------

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
        for name, title in (("detail", "node"), ("streams", "latency by priority"), ("timeline", "timeline")):
            self.query_one(f"#{name}", Static).border_title = title
        self.map.border_title = "map"
        grades = (Grade.GOOD, Grade.FAIR, Grade.POOR, Grade.DOWN)
        self.map.border_subtitle = "  ".join(f"[{palette.GRADES[g]}]{palette.SIGNS[g]}[/] {g}" for g in grades)
        self.set_interval(1 / self._rate_hz, self._look)
        self.set_interval(1.0, self._draw_panels)
        self._watch_status()

    @property
    def map(self) -> MapView:
        """The map."""
        return self.query_one(MapView)

    def _look(self) -> None:
        """Take in what has been recorded, and draw the map."""
        self.model.describe(self.session.metadata())
        for record in self.session.records():
            self.model.take(record)
        if self.map.chosen is None and self.model.nodes and not self.standing.t_s:
            self._draw_panels()
        self.map.update_map()

    def _draw_panels(self) -> None:
        head = self.query_one("#head", Static)
        head.update(panels.head_text(self.model, self.standing, self.size.width))
        for name, make in self._panels().items():
            widget = self.query_one(f"#{name}", Static)
            if widget.content_size.width > 0:
                widget.update(make(widget.content_size.width, widget.content_size.height))

    def _panels(self) -> Mapping[str, Callable[[int, int], Text]]:
        return {
            "detail": self._detail,
            "streams": lambda width, lines: panels.streams_text(self.model, width=width, lines=lines),
            "timeline": lambda _width, lines: panels.timeline_text(self.model, self.standing, lines=lines),
        }

    def _detail(self, _width: int, lines: int) -> Text:
        chosen = self.map.chosen
        detail = self.query_one("#detail", Static)
        detail.border_title = "link" if isinstance(chosen, frozenset) else "node"
        if isinstance(chosen, frozenset) and chosen in self.model.links:
            return panels.link_text(self.model.links[chosen])
        if isinstance(chosen, str) and chosen in self.model.nodes:
            return panels.node_text(self.model.nodes[chosen], self.standing, lines=lines)
        if self.verdict:
            return Text(self.verdict)
        return panels.overview_text(self.model, self.standing)

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
        self.verdict = await asyncio.to_thread(self.session.report)
        self.map.chosen = None
        self.query_one("#detail", Static).border_title = "result"
        self._say("The scenario is over; its result is on the right. q quits.")
        self._draw_panels()

    def _say(self, text: str, *, bad: bool = False) -> None:
        style = palette.WARNING if bad else palette.TEXT
        self.query_one("#said", Static).update(Text(f" {text.splitlines()[0] if text else ''}", style=style))

    # -- choosing -------------------------------------------------------------------------------------------------

    def action_node(self, step: int) -> None:
        """Go to the next node; while a robot is being moved, its target goes aside."""
        if self.map.target_m is not None:
            self._shift(step, 0)
            return
        names = [name for name, node in self.model.nodes.items() if node.active] or list(self.model.nodes)
        chosen = self.map.chosen
        if names:
            place = names.index(chosen) + step if isinstance(chosen, str) and chosen in names else min(0, step)
            self._choose(names[place % len(names)])

    def action_link(self, step: int) -> None:
        """Go to the next link; while a robot is being moved, its target goes up or down."""
        if self.map.target_m is not None:
            self._shift(0, -step)
            return
        keys = [frozenset((link.a, link.b)) for link in self.model.shown_links()]
        chosen = self.map.chosen
        if keys:
            place = keys.index(chosen) + step if isinstance(chosen, frozenset) and chosen in keys else min(0, step)
            self._choose(keys[place % len(keys)])

    def on_map_view_picked(self, event: MapView.Picked) -> None:
        """A click: choose what was clicked, or say where a robot shall go."""
        if self.map.target_m is not None:
            self.map.target_m = event.place_m
            self.map.update_map()
        elif event.chosen is not None:
            self._choose(event.chosen)

    def _choose(self, chosen: str | frozenset[str]) -> None:
        self.map.chosen = chosen
        self.map.update_map()
        self._draw_panels()
        self._saw(Deed.LINK if isinstance(chosen, frozenset) else Deed.NODE)

    def _chosen_link(self) -> tuple[str, str] | None:
        chosen = self.map.chosen
        if isinstance(chosen, frozenset):
            a, b = sorted(chosen)
            return a, b
        self._say("Pick a link first: ↓ or a click on it.", bad=True)
        return None

    def _chosen_node(self) -> str | None:
        if isinstance(self.map.chosen, str):
            return self.map.chosen
        self._say("Pick a node first: → or a click on it.", bad=True)
        return None

    # -- acts -----------------------------------------------------------------------------------------------------

    @work(group="acts")
    async def _act(self, said: str, deed: Deed | None, do: str, **values: Any) -> None:
        try:
            reply = await asyncio.to_thread(self.session.act, do, **values)
            self.standing = Standing.of(await asyncio.to_thread(self.session.status))
        except NetlabError as error:
            self._say(str(error), bad=True)
            return
        told = ", ".join(reply.get("labels", ())) or str(reply.get("label", ""))
        self._say(f"{said}{told}")
        self._look()
        self._draw_panels()
        if deed is not None:
            self._saw(deed)

    def action_cut(self) -> None:
        """Cut the link, or restore it."""
        if (ends := self._chosen_link()) is not None:
            cut = self.model.links[frozenset(ends)].is_cut
            said = f"{'Restored' if cut else 'Cut'} {ends[0]}-{ends[1]}"
            self._act(said, Deed.CUT, "outage", between=list(ends), active=not cut)

    @work
    async def action_flap(self) -> None:
        """Ask how the link shall flap."""
        ends = self._chosen_link()
        if ends is None:
            return
        fields = (Field("down", "down for", "1s"), Field("up", "up for", "2s"), Field("for", "all in all", "20s"))
        answer = await self.app.push_screen_wait(Form(f"Flap {ends[0]}-{ends[1]}", fields))
        if answer is not None:
            try:
                times = {f"{key}_s": DURATION.parse(value) for key, value in answer.items()}
            except ValueError as error:
                self._say(str(error), bad=True)
                return
            self._act(f"{ends[0]}-{ends[1]} flaps", None, "flap", between=list(ends), **times)

    @work
    async def action_degrade(self) -> None:
        """Ask what the link shall suffer."""
        ends = self._chosen_link()
        if ends is None:
            return
        fields = (
            Field("loss", "loss", "20%", "20%, or {gemodel: {p: 1%, r: 25%}}"),
            Field("delay", "delay", "", "50ms"),
            Field("rate", "rate", "", "1mbit"),
        )
        answer = await self.app.push_screen_wait(Form(f"Degrade {ends[0]}-{ends[1]}", fields, "Empty: unchanged.  "))
        words = {key: value for key, value in (answer or {}).items() if value}
        if words:
            told = ", ".join(f"{key} {value}" for key, value in words.items())
            self._act(f"{ends[0]}-{ends[1]}: {told}", Deed.DEGRADE, "link", between=list(ends), words=words)

    def action_move(self) -> None:
        """Begin to move the node: arrows or a click say where to."""
        name = self._chosen_node()
        if name is not None:
            self.map.target_m = self.map.places()[name]
            self.map.update_map()
            self._say(f"Move {name}: arrows or a click; Enter puts it there, g sends it walking, Esc leaves it.")

    def _shift(self, right: int, up: int) -> None:
        assert self.map.target_m is not None
        across, down = self.map.cell_m
        x, y = self.map.target_m
        self.map.target_m = (x + right * across, y + up * down)
        self.map.update_map()

    def action_enter(self) -> None:
        """Put the node there at once; elsewhere, the tour's next step."""
        self._move(None)

    def action_walk(self) -> None:
        """Send the node there."""
        if self.map.target_m is not None:
            self._move(_WALK_MPS)

    def _move(self, speed_mps: float | None) -> None:
        place_m, name = self.map.target_m, self.map.chosen
        if place_m is None or not isinstance(name, str):
            self._saw(Deed.NEXT)
            return
        self.map.target_m = None
        to = [round(value, 1) for value in place_m]
        said = f"{name} {'walks' if speed_mps else 'moved'} to {to[0]:g}, {to[1]:g}"
        self._act(said, None, "move", node=name, to=to, speed_mps=speed_mps)

    def action_back(self) -> None:
        """Leave the move, the tour, the choice: one at a time."""
        if self.map.target_m is not None:
            self.map.target_m = None
            self._say("")
        elif self.tour is not None:
            self.tour = None
            self._draw_tour()
        else:
            self.map.chosen = None
        self.map.update_map()
        self._draw_panels()

    @work
    async def action_deploy(self) -> None:
        """Drop a relay; of several, ask which."""
        waiting = {
            name: carrier
            for name, carrier in self.session.carriers.items()
            if name not in self.model.nodes or not self.model.nodes[name].active
        }
        mine = {name: carrier for name, carrier in waiting.items() if self.map.chosen in (name, carrier)}
        names = list(mine or waiting)
        if not names:
            self._say("Nobody carries a relay any more." if self.session.carriers else "Nobody carries a relay here.")
            return
        options = [f"{name}  (carried by {waiting[name]})" for name in names]
        picked = options[0] if len(names) == 1 else await self.app.push_screen_wait(Choice("Which relay?", options))
        if picked is not None:
            name = names[options.index(picked)]
            self._act(f"{name} lies on the ground now", None, "deploy", node=name)

    @work
    async def action_kill(self) -> None:
        """Kill a process of the node; of several, ask which."""
        await self._process("Kill which process?", "Killed", "kill", lambda state: state != "exited")

    @work
    async def action_restart(self) -> None:
        """Start a process of the node again."""
        await self._process("Start which process?", "Started", "start", lambda state: state == "exited")

    async def _process(self, question: str, said: str, do: str, fits: Callable[[str], bool]) -> None:
        node = self._chosen_node()
        if node is None:
            return
        processes = self.standing.processes_of(node)
        own = [process for process in processes if process["process"] not in (SOURCE, SINK)]  # the rest is the lab's
        names = [str(process["process"]) for process in own if fits(str(process["state"]))]
        if not names:
            self._say(f"{node} has no such process: {_listed(own)}", bad=True)
            return
        name = names[0] if len(names) == 1 else await self.app.push_screen_wait(Choice(question, names))
        if name is not None:
            self._act(f"{said} {name} on {node}", None, do, node=node, process=name)

    def action_shell(self) -> None:
        """A shell in the node, until it ends."""
        node = self._chosen_node()
        if node is None:
            return
        if self.app.is_web:
            self._say(f"a browser has no room for a shell; in a terminal: netlab shell {node}", bad=True)
            return
        with self.app.suspend():
            print(f"\nA shell in {node}; the lab goes on. Its end (exit, or Ctrl+D) leads back.\n")
            try:
                self.session.shell(node)
            except NetlabError as error:
                print(error)
        self.refresh()

    def action_hold(self) -> None:
        """Let the timeline stand still, or go on."""
        if self.standing.held:
            self._act("The timeline goes on", Deed.RESUME, "resume")
        else:
            self._act("Events and motion stand still; programs and traffic go on", Deed.HOLD, "hold")

    def action_step(self) -> None:
        """Carry out the next event."""
        self._act("Done now: ", None, "step")

    @work
    async def action_mark(self) -> None:
        """Ask for a word, and mark the moment at which the key was pressed."""
        at_s = self.standing.t_s or 0.0
        answer = await self.app.push_screen_wait(
            Form("Mark this moment", [Field("text", "what is it?", f"mark {at_s:.0f} s")])
        )
        if answer is not None:
            self._act(f"Marked: {answer['text']}", Deed.MARK, "mark", text=answer["text"])

    def action_record(self) -> None:
        """End the recording, or begin another one."""
        if self.standing.recording:
            self._act("The recording is finished", None, "record", file=None)
        else:
            file = _unused(self._captures, self.session.title, ".mcap")
            self._act(f"Recording to {file.name}", None, "record", file=str(file))

    def action_undo(self) -> None:
        """Take the last act back."""
        self._act("Undone: ", Deed.UNDO, "undo")

    @work
    async def action_save(self) -> None:
        """Ask for a file, and save what was done as a scenario."""
        proposed = _unused(self._captures, f"{self.session.title}-replay", ".yaml")
        answer = await self.app.push_screen_wait(
            Form("Save all that was done as a scenario", [Field("file", "file", short(proposed))])
        )
        if answer is None:
            return
        file = Path(answer["file"])
        try:
            left_out = await asyncio.to_thread(self.session.save, file.resolve())
        except NetlabError as error:
            self._say(str(error), bad=True)
            return
        self._say(f"Saved: netlab run {answer['file']}" + "".join(f"  (left out: {text})" for text in left_out))
        self._saw(Deed.SAVE)

    # -- the tour -------------------------------------------------------------------------------------------------

    def action_tour(self) -> None:
        """Begin the tour, or leave it."""
        self.tour = Tour() if self.tour is None else None
        self._draw_tour()

    def _saw(self, deed: Deed) -> None:
        if self.tour is not None and self.tour.saw(deed):
            self._draw_tour()

    def _draw_tour(self) -> None:
        panel = self.query_one("#tour", Static)
        step = self.tour.step if self.tour is not None else None
        if step is None:
            self.tour = None
            panel.display = False
            return
        panel.display = True
        assert self.tour is not None
        panel.update(panels.tour_text(step.title, step.text, self.tour.place))


def _listed(processes: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(f"{process['process']} is {process['state']}" for process in processes) or "it runs nothing"


def _unused(folder: Path, stem: str, suffix: str) -> Path:
    """A file in a folder that is not there yet."""
    names = (f"{stem}{suffix}", *(f"{stem}-{number}{suffix}" for number in range(2, 10_000)))
    return next(path for name in names if not (path := folder / name).exists())
