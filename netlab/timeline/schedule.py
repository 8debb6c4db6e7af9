"""When the entries of a timeline are carried out, while a person holds it, lets it go on and steps through it.

Theory. Two clocks. Run time is that of processes, traffic and the capture; nothing stops it. Script time is that of
the scenario's events and motion: run time less all holds so far; while the timeline is held it stands still. An entry
is due when script time reaches its ``at_s``. A step carries out the next moment early and leaves the rest as it was.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import takewhile

from netlab.timeline.entries import Entry


class Standstill:
    """For how long something has stood still, on behalf of several holders. All ``now_s`` are run time."""

    def __init__(self) -> None:
        self._holders: set[str] = set()
        self._since_s = 0.0
        #: Spans that are over: (from, for) in seconds, in order.
        self.spans: list[tuple[float, float]] = []

    def __bool__(self) -> bool:
        return bool(self._holders)

    def hold(self, holder: str, now_s: float) -> None:
        """Stand still from now on, at least until ``holder`` lets go."""
        if not self._holders:
            self._since_s = now_s
        self._holders.add(holder)

    def release(self, holder: str, now_s: float) -> None:
        """Let go; it goes on when nobody holds it any more."""
        if self._holders == {holder}:
            self.spans.append((self._since_s, max(0.0, now_s - self._since_s)))
        self._holders.discard(holder)

    def total_s(self, now_s: float) -> float:
        """For how long it has stood still until now."""
        present_s = max(0.0, now_s - self._since_s) if self._holders else 0.0
        return sum(for_s for _, for_s in self.spans) + present_s


class Schedule:
    """The coming entries of one run, and what has become of the others. All ``now_s`` are run time."""

    def __init__(self, entries: Iterable[Entry]) -> None:
        """``entries`` are sorted by time."""
        self._coming = list(entries)
        self.standstill = Standstill()
        #: What has been carried out: (entry, run time).
        self.done: list[tuple[Entry, float]] = []

    @property
    def is_held(self) -> bool:
        """Whether the timeline stands still."""
        return bool(self.standstill)

    @property
    def coming(self) -> tuple[Entry, ...]:
        """What has not been carried out, in order; ``at_s`` is script time."""
        return tuple(self._coming)

    def script_s(self, now_s: float) -> float:
        """Script time."""
        return now_s - self.standstill.total_s(now_s)

    def run_s(self, script_s: float, now_s: float) -> float:
        """When a coming script time will be, in run time, if nothing holds it any more from now on."""
        return script_s + self.standstill.total_s(now_s)

    def next_due_s(self, now_s: float) -> float | None:
        """Run time of the next entry; None while the timeline is held, or when nothing comes any more."""
        return None if self.is_held or not self._coming else self.run_s(self._coming[0].at_s, now_s)

    def take_due(self, now_s: float) -> list[Entry]:
        """Take the entries that are due; while the timeline is held none becomes so."""
        script_s = self.script_s(now_s)
        return self._take(len(list(takewhile(lambda entry: entry.at_s <= script_s, self._coming))), now_s)

    def step(self, now_s: float) -> list[Entry]:
        """Take all entries of the next moment, before their time."""
        if not self._coming:
            return []
        at_s = self._coming[0].at_s
        return self._take(len(list(takewhile(lambda entry: entry.at_s == at_s, self._coming))), now_s)

    def drop(self, entry: Entry) -> None:
        """Forget an entry that somebody has forestalled."""
        self._coming.remove(entry)

    def _take(self, count: int, now_s: float) -> list[Entry]:
        taken, self._coming = self._coming[:count], self._coming[count:]
        self.done += [(entry, now_s) for entry in taken]
        return taken
