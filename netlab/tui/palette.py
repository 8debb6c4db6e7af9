"""The colours of the screen, told apart by lightness too, so that they read without colour vision."""

from __future__ import annotations

from netlab.live.links import Grade

GRADES = {
    Grade.GOOD: "#35c48d",
    Grade.FAIR: "#e5c453",
    Grade.POOR: "#f08a4b",
    Grade.DOWN: "#e0485f",
    Grade.OUT_OF_RANGE: "#56606e",
}
#: Signs besides the colours.
SIGNS = {Grade.GOOD: "━", Grade.FAIR: "╍", Grade.POOR: "┅", Grade.DOWN: "✕", Grade.OUT_OF_RANGE: "·"}
ROCK = "#6d6453"
FLOOR = "#221f1a"
GROUND = "#12161c"
DIM = "#8a94a3"
TEXT = "#d7dde6"
CHOSEN = "#ffffff"
ACCENT = "#5aa9e6"
WARNING = "#f08a4b"
GONE = "#56606e"
_PRIORITIES = (
    "#7ad3ff",
    "#5aa9e6",
    "#9b8cff",
    "#c77dff",
    "#e86bc8",
    "#ff7b9c",
    "#f0a35e",
    "#cdb55a",
    "#9aa06a",
    "#8a94a3",
)


def priority(number: int) -> str:
    """The colour of a priority; the most urgent ones are the lightest blue."""
    return _PRIORITIES[min(max(number, 0), len(_PRIORITIES) - 1)]


def latency(latency_s: float | None) -> str:
    """The colour of a latency."""
    if latency_s is None:
        return DIM
    return GRADES[Grade.GOOD if latency_s < 0.05 else Grade.FAIR if latency_s < 0.2 else Grade.POOR]
