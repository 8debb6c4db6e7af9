"""The application: choose a topology, bring the lab up, show it; the lab ends with it."""

from __future__ import annotations

import asyncio
import gc
import os
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from textual import work
from textual.app import App, ComposeResult, SystemCommand
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.screen import Screen
from textual.widgets import Label, LoadingIndicator

from netlab.errors import NetlabError
from netlab.tui.chooser import Chooser, Topology
from netlab.tui.files import short
from netlab.tui.screen import MainScreen
from netlab.tui.session import Session

_RATE_HZ, _REMOTE_RATE_HZ = 4.0, 2.0
_COLLECT_EVERY = 20_000  # objects more than were freed


class Starting(Screen[None]):
    """While the lab comes up."""

    def __init__(self, what: str) -> None:
        super().__init__()
        self._what = what

    def compose(self) -> ComposeResult:
        """Lay it out."""
        with Vertical(id="starting"):
            yield LoadingIndicator()
            yield Label(f"bringing up {self._what}: namespaces, links, processes, discovery")


class LabApp(App[NetlabError | None]):
    """The interactive lab; returns the error that ended it, if any.

    Attributes:
        session: The lab, once a topology is chosen.
    """

    TITLE = "netlab"
    CSS_PATH = "lab.tcss"
    ENABLE_COMMAND_PALETTE = True
    BINDINGS: ClassVar[list[BindingType]] = [Binding("ctrl+c", "quit", "quit", show=False, priority=True)]

    def __init__(
        self,
        make_session: Callable[[Path], Session],
        file: Path | None,
        *,
        choices: list[Topology] | None = None,
        captures: Path = Path("captures"),
        rate_hz: float | None = None,
    ) -> None:
        """Without a ``file`` the person chooses one of ``choices``. ``rate_hz``: how often the map is drawn."""
        super().__init__()
        self.session: Session | None = None
        self._make_session = make_session
        self._file = file
        self._seen: list[MainScreen] = []
        self._choices = choices or []
        self._captures = captures
        remote = "SSH_CONNECTION" in os.environ
        self._rate_hz = rate_hz or (_REMOTE_RATE_HZ if remote else _RATE_HZ)

    def on_mount(self) -> None:
        """Begin."""
        self._run_lab()

    @work
    async def _run_lab(self) -> None:
        file = self._file or await self.push_screen_wait(Chooser(self._choices))
        if file is None:
            self.exit(None)
            return
        self.push_screen(Starting(file.stem))
        try:
            self.session = self._make_session(file)
            await asyncio.to_thread(self.session.start)
        except NetlabError as error:
            self.exit(error)
            return
        _leave_standing_objects_alone()
        screen = MainScreen(self.session, captures=self._captures.resolve(), rate_hz=self._rate_hz)
        self._seen.append(screen)
        self.switch_screen(screen)

    def farewell(self) -> str:
        """What stays when the screen is gone."""
        verdicts = [screen.verdict.report for screen in self._seen if screen.verdict is not None]
        verdict = f"{verdicts[-1]}\n\n" if verdicts else ""
        files = self.session.files if self.session is not None else ()
        return verdict + "\n".join(f"{kind}: {short(file)}" for kind, file in files)

    def get_system_commands(self, screen: Screen[object]) -> list[SystemCommand]:
        """The keys of the main screen by their names, for the palette."""
        if not isinstance(screen, MainScreen):
            return list(super().get_system_commands(screen))
        return [
            SystemCommand(_spoken(method), (getattr(screen, method).__doc__ or "").strip(), getattr(screen, method))
            for method in _COMMANDS
        ] + list(super().get_system_commands(screen))


def _leave_standing_objects_alone() -> None:
    """Have the garbage collector look at what comes only: records come by the thousand, and none of them in cycles.

    Looking through all that has been loaded again and again took a fifth of the screen's processor time.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(_COLLECT_EVERY)


_COMMANDS = (
    "action_cut",
    "action_flap",
    "action_degrade",
    "action_move",
    "action_deploy",
    "action_kill",
    "action_restart",
    "action_shell",
    "action_hold",
    "action_step",
    "action_mark",
    "action_record",
    "action_undo",
    "action_save",
    "action_tour",
)


def _spoken(method: str) -> str:
    return method.removeprefix("action_").capitalize()
