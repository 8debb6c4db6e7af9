"""Commands and their answers over a network that loses both: asked again, carried out once. Pure.

The caller repeats a command, with the same number, until an answer comes or its time is over. The receiver remembers
its answers for a while and gives a repeated command the same one, so that a lost answer makes no robot act twice.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from rose.core.addressing import ServiceId

_Answer = TypeVar("_Answer")

#: Answers that a receiver remembers, and for how long.
ANSWERS_MAX = 1024
REMEMBER_S = 60.0

CommandKey = tuple[ServiceId, int, int]
"""Who asked, in which epoch, under which number."""


def repeat_at(*, timeout_s: float, first_s: float = 0.05, factor: float = 2.0, most_s: float = 1.0) -> Iterator[float]:
    """Yield after how many seconds a command is sent: at once, then with growing pauses below ``timeout_s``."""
    at_s, pause_s = 0.0, first_s
    while at_s < timeout_s:
        yield at_s
        at_s += pause_s
        pause_s = min(pause_s * factor, most_s)


@dataclass(frozen=True, slots=True)
class Running:
    """The command is being carried out; its repetitions wait for that."""


RUNNING = Running()


class AnswerCache(Generic[_Answer]):
    """What a receiver has answered, by command."""

    def __init__(self, *, answers_max: int = ANSWERS_MAX, remember_s: float = REMEMBER_S) -> None:
        """At most ``answers_max`` are kept, none longer than ``remember_s`` seconds."""
        self._answers_max = answers_max
        self._remember_s = remember_s
        self._entries: OrderedDict[CommandKey, tuple[float, Running | _Answer]] = OrderedDict()

    def begin(self, key: CommandKey, *, now: float) -> Running | _Answer | None:
        """Return None, once, for a new command, which then counts as running; else what is known of it."""
        while self._entries and next(iter(self._entries.values()))[0] < now - self._remember_s:
            self._entries.popitem(last=False)
        entry = self._entries.get(key)
        if entry is not None:
            return entry[1]
        self._entries[key] = (now, RUNNING)
        if len(self._entries) > self._answers_max:
            self._entries.popitem(last=False)
        return None

    def finish(self, key: CommandKey, answer: _Answer, *, now: float) -> None:
        """Remember the answer to a command."""
        if key in self._entries:
            self._entries[key] = (now, answer)
            self._entries.move_to_end(key)
