"""The keys at the bottom of the screen, in groups by what they act on; each can be clicked."""

from __future__ import annotations

from rich.style import Style
from rich.text import Text
from textual import events
from textual.widgets import Static

from netlab.tui import palette

_ACTION = "netlab_action"
_WIDE = 96
#: Lines of groups: (what they act on, ((key, word, action), ...)).
_LINES = (
    (
        ("link ↑↓", (("c", "cut", "cut"), ("f", "flap", "flap"), ("d", "degrade", "degrade"))),
        (
            "node ←→",
            (
                ("m", "move", "move"),
                ("p", "place", "deploy"),
                ("x", "kill", "kill"),
                ("r", "restart", "restart"),
                ("s", "shell", "shell"),
            ),
        ),
    ),
    (
        ("time", (("space", "hold", "hold"), (".", "step", "step"), ("b", "mark", "mark"))),
        ("lab", (("u", "undo", "undo"), ("w", "save", "save"), ("o", "record", "record"))),
        ("help", (("?", "tour", "tour"), ("^p", "all", "app.command_palette"), ("q", "quit", "app.quit"))),
    ),
)


class KeyBar(Static):
    """Two lines of keys."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__("", id=id)

    def on_resize(self, event: events.Resize) -> None:
        """Fit into the width."""
        self.update(key_text(event.size.width))

    async def on_click(self, event: events.Click) -> None:
        """Do what the key would."""
        action = event.style.meta.get(_ACTION)
        if action:
            await self.run_action(action if "." in action else f"screen.{action}")


def key_text(width: int) -> Text:
    """The two lines; on a narrow screen without what the groups act on."""
    wide = width >= _WIDE
    text = Text(no_wrap=True)
    for groups in _LINES:
        for place, (name, keys) in enumerate(groups):
            text.append(f"{' │' if place else ''}{f' {name} ' if wide else ''}", style=palette.DIM)
            for key, word, action in keys:
                meta = Style.from_meta({_ACTION: action})
                text.append(f" {key} ", style=Style(color=palette.ACCENT, bold=True) + meta)
                text.append(word, style=Style(color=palette.TEXT) + meta)
        text.append("\n")
    return text
