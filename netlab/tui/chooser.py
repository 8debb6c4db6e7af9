"""Choosing a topology from a list: the scenario files of a folder, each with what its first comment says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical
from textual.screen import Screen
from textual.widgets import Label, OptionList, Static
from textual.widgets.option_list import Option

from netlab.tui import palette


@dataclass(frozen=True, slots=True)
class Topology:
    """A scenario file, and what it says of itself."""

    file: Path
    about: str


def topologies(folder: Path) -> list[Topology]:
    """The scenario files of a folder, the default first."""
    files = sorted(folder.glob("*.yaml"), key=lambda file: (file.stem != "default", file.stem))
    return [Topology(file, about(file.read_text(errors="replace"))) for file in files]


def about(text: str) -> str:
    """The comment at a file's top, as one paragraph."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").rstrip())
    return " ".join(lines)


class Chooser(Screen[Path | None]):
    """Gives the file that was chosen; None to quit."""

    BINDINGS: ClassVar[list[BindingType]] = [("q", "leave", "Quit"), ("escape", "leave", "Quit")]

    def __init__(self, found: Sequence[Topology]) -> None:
        super().__init__()
        self._found = found

    def compose(self) -> ComposeResult:
        """Lay it out."""
        with Vertical(id="chooser"):
            yield Label("Choose a topology", classes="dialog-title")
            yield OptionList(*(Option(self._line(topology)) for topology in self._found), id="topologies")
            yield Static("", id="about")
            yield Label("↑ ↓ Enter   q: quit", classes="dialog-note")

    def on_mount(self) -> None:
        """Begin at the first."""
        self.query_one(OptionList).focus()

    def on_option_list_option_highlighted(self, event: OptionList.OptionHighlighted) -> None:
        """Tell more of the one that is pointed at."""
        topology = self._found[event.option_index]
        self.query_one("#about", Static).update(Text(topology.about or "(its file does not say)"))

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Give it."""
        self.dismiss(self._found[event.option_index].file)

    def action_leave(self) -> None:
        """Give nothing."""
        self.dismiss(None)

    @staticmethod
    def _line(topology: Topology) -> Text:
        text = Text(no_wrap=True, overflow="ellipsis")
        text.append(f"{topology.file.stem:<18}", style=f"bold {palette.ACCENT}")
        text.append(topology.about.partition(". ")[0], style=palette.TEXT)
        return text
