"""Small questions: a few fields, or one of a list. A dialog gives its answer when it goes, None if cancelled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import Input, Label, OptionList
from textual.widgets.option_list import Option


@dataclass(frozen=True, slots=True)
class Field:
    """One line to fill in."""

    key: str
    label: str
    value: str = ""
    hint: str = ""


class Form(ModalScreen[dict[str, str] | None]):
    """Asks for a few values; Enter in the last one gives them, Esc cancels."""

    BINDINGS: ClassVar[list[BindingType]] = [("escape", "cancel", "cancel")]

    def __init__(self, title: str, fields: Sequence[Field], note: str = "") -> None:
        super().__init__()
        self._title, self._fields, self._note = title, fields, note

    def compose(self) -> ComposeResult:
        """Lay it out."""
        with Vertical(classes="dialog"):
            yield Label(self._title, classes="dialog-title")
            for field in self._fields:
                yield Label(field.label, classes="dialog-label")
                yield Input(field.value, placeholder=field.hint, id=f"field-{field.key}", compact=True)
            yield Label(f"{self._note}Enter: next, then done   Esc: cancel", classes="dialog-note")

    def on_mount(self) -> None:
        """Begin in the first field."""
        self.query(Input).first().focus()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Go on to the next field, or give the answer."""
        inputs = list(self.query(Input))
        place = inputs.index(event.input)
        if place + 1 < len(inputs):
            self.set_focus(inputs[place + 1])
        else:
            answers = zip(self._fields, inputs, strict=True)
            self.dismiss({field.key: entry.value.strip() for field, entry in answers})

    def action_cancel(self) -> None:
        """Give nothing."""
        self.dismiss(None)


class Choice(ModalScreen[str | None]):
    """Asks for one of a list."""

    BINDINGS: ClassVar[list[BindingType]] = [("escape", "cancel", "cancel")]

    def __init__(self, title: str, options: Sequence[str]) -> None:
        super().__init__()
        self._title, self._options = title, options

    def compose(self) -> ComposeResult:
        """Lay it out."""
        with Vertical(classes="dialog"):
            yield Label(self._title, classes="dialog-title")
            yield OptionList(*(Option(Text(text), id=str(index)) for index, text in enumerate(self._options)))
            yield Label("↑ ↓ Enter   Esc: cancel", classes="dialog-note")

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Give the choice."""
        self.dismiss(self._options[event.option_index])

    def action_cancel(self) -> None:
        """Give nothing."""
        self.dismiss(None)
