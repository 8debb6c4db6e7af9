"""What the keys of the main screen do to the lab."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

from textual import work
from textual.binding import Binding, BindingType

from netlab.errors import NetlabError
from netlab.scenario.quantities import DURATION
from netlab.tui import offers
from netlab.tui.dialogs import Choice, Field, Form
from netlab.tui.files import short, unused
from netlab.tui.scene import places
from netlab.tui.session import Session
from netlab.tui.standing import Standing
from netlab.tui.tour import Deed
from netlab.tui.watch_screen import WatchScreen

_WALK_MPS = 1.5


class MainScreen(WatchScreen):
    """One lab on one screen, in a person's hands."""

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
        super().__init__(session, rate_hz=rate_hz)
        self._captures = captures

    @work(group="acts")
    async def _act(self, said: str, deed: Deed | None, do: str, **values: Any) -> None:
        """Do something to the lab, and tell how that went."""
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

    # -- links ----------------------------------------------------------------------------------------------------

    def _chosen_link(self) -> tuple[str, str] | None:
        chosen = self.map.chosen
        if isinstance(chosen, frozenset):
            a, b = sorted(chosen)
            return a, b
        self._say("Pick a link first: ↓ or a click on it.", bad=True)
        return None

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

    # -- nodes ----------------------------------------------------------------------------------------------------

    def _chosen_node(self) -> str | None:
        if isinstance(self.map.chosen, str):
            return self.map.chosen
        self._say("Pick a node first: → or a click on it.", bad=True)
        return None

    def action_move(self) -> None:
        """Begin to move the node: arrows or a click say where to."""
        name = self._chosen_node()
        if name is not None:
            self._aim(places(self.model)[name])
            self._say(f"Move {name}: arrows or a click; Enter: put it there, g: send it, Esc: leave it")

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

    @work
    async def action_deploy(self) -> None:
        """Drop a relay; of several, ask which."""
        waiting = offers.waiting_relays(self.model, self.session.carriers, self.map.chosen)
        names = list(waiting)
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
        own = offers.own_processes(self.standing, node)
        names = offers.process_names(own, fits)
        if not names:
            self._say(f"{node} has no such process: {offers.told_states(own)}", bad=True)
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

    # -- the timeline and the recording ---------------------------------------------------------------------------

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
        pressed_s, at_s = time.monotonic(), self.standing.t_s or 0.0
        field = Field("text", "what is it?", f"mark {at_s:.0f} s")
        answer = await self.app.push_screen_wait(Form("Mark this moment", [field]))
        if answer is not None:
            text, ago_s = answer["text"] or field.value, time.monotonic() - pressed_s
            self._act(f"Marked: {text}", Deed.MARK, "mark", text=text, ago_s=ago_s)

    def action_record(self) -> None:
        """End the recording, or begin another one."""
        if self.standing.recording:
            self._act("The recording is finished", None, "record", file=None)
        else:
            file = unused(self._captures, self.session.title, ".mcap")
            self._act(f"Recording to {file.name}", None, "record", file=str(file))

    def action_undo(self) -> None:
        """Take the last act back."""
        self._act("Undone: ", Deed.UNDO, "undo")

    @work
    async def action_save(self) -> None:
        """Ask for a file, and save what was done as a scenario."""
        field = Field("file", "file", short(unused(self._captures, f"{self.session.title}-replay", ".yaml")))
        answer = await self.app.push_screen_wait(Form("Save all that was done as a scenario", [field]))
        if answer is None:
            return
        name = answer["file"] or field.value
        file = Path(name).expanduser()
        try:
            left_out = await asyncio.to_thread(self.session.save, file.resolve())
        except NetlabError as error:
            self._say(str(error), bad=True)
            return
        self._say(f"Saved: netlab run {name}" + "".join(f"  (left out: {text})" for text in left_out))
        self._saw(Deed.SAVE)
