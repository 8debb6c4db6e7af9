"""The tour: what a newcomer does in the first two minutes. Pure: steps, and which deed leads on."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Deed(StrEnum):
    """What a person did, as far as the tour asks for it."""

    NEXT = "next"
    NODE = "node"
    LINK = "link"
    CUT = "cut"
    UNDO = "undo"
    DEGRADE = "degrade"
    HOLD = "hold"
    RESUME = "resume"
    MARK = "mark"
    SAVE = "save"


@dataclass(frozen=True, slots=True)
class Step:
    """A step's text, and the deed that completes it; Enter always leads on."""

    title: str
    text: str
    deed: Deed


STEPS = (
    Step(
        "Welcome",
        "Real programs run in every robot's own network namespace. The map shows where they are and how well they hear "
        "each other; below it, how late messages arrive by priority. Press Enter.",
        Deed.NEXT,
    ),
    Step(
        "A node", "Press → to pick a robot (or click it). On the right: its peers, queues, processes, log.", Deed.NODE
    ),
    Step("A link", "Press ↓ to pick a link. Green is good, yellow fair, orange poor, red down.", Deed.LINK),
    Step("Cut it", "Press c: everything on this link is lost silently, as in a tunnel. c again restores it.", Deed.CUT),
    Step(
        "What it does",
        "Watch the latencies below stop, and queues grow in the nodes (→). The timeline, lower right, has your deed. "
        "Press Enter.",
        Deed.NEXT,
    ),
    Step("Take it back", "Press u to undo. Each deed can be undone, one after the other.", Deed.UNDO),
    Step("Degrade", "Pick a link (↓) and press d: give it loss, delay or a rate, then Enter to the end.", Deed.DEGRADE),
    Step("Hold", "Press space: coming events and motion stand still; programs and traffic go on.", Deed.HOLD),
    Step("Go on", "A dot . carries out the next event now. Press space to let the timeline go on.", Deed.RESUME),
    Step("Mark", "Press b to mark a moment: it stands in the capture for later.", Deed.MARK),
    Step("Save", "Press w: all that you did becomes a scenario file that does it again.", Deed.SAVE),
    Step(
        "That is all",
        "m moves a robot, p places a relay, x kills a program, r starts it again, s opens a shell. ? shows this tour, "
        "Ctrl+P everything else, q quits. Press Enter.",
        Deed.NEXT,
    ),
)


class Tour:
    """Where somebody is in the tour."""

    def __init__(self) -> None:
        self.place = 0

    @property
    def step(self) -> Step | None:
        """The present step; None when it is over."""
        return STEPS[self.place] if self.place < len(STEPS) else None

    def saw(self, deed: Deed) -> bool:
        """Take note of a deed; whether that led on."""
        if self.step is None or deed not in (self.step.deed, Deed.NEXT):
            return False
        self.place += 1
        return True
