"""What waits for one member: strict priority between classes of urgency, next hops in turn within a class.

A next hop with too much under way does not hold up the others. A class holds a bounded number of frames; beyond it the
oldest of the longest row goes. Each row has its CoDel; the owner throws away what it condemns, and what has waited too
long.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from wnet.core.codel import CoDel
from wnet.core.link import Link
from wnet.core.transmissions import Transmission

CLASSES = 8
_GROUPS = None  # the row of frames for several next hops

_Row = deque[Transmission]


class MemberQueue:
    """The frames that wait for one member."""

    def __init__(self, limit: int, target_s: float) -> None:
        """``limit``: frames per class; ``target_s``: how long they may wait where a row never gets empty."""
        self._limit = limit
        self._target_s = target_s
        self._judges: dict[tuple[int, Link | None], CoDel] = {}
        self._rows: list[dict[Link | None, _Row]] = [{} for _ in range(CLASSES)]
        self.lengths = [0] * CLASSES

    def __len__(self) -> int:
        return sum(self.lengths)

    def push(self, transmission: Transmission, *, is_first: bool = False) -> Transmission | None:
        """Take a frame, ``is_first`` ahead of its row; return the one that had to go for it."""
        urgency = transmission.packet.urgency
        rows = self._rows[urgency]
        dropped = None
        if self.lengths[urgency] >= self._limit:
            longest = max(rows, key=lambda key: len(rows[key]))
            dropped = self._take(urgency, longest)
        key = _key(transmission)
        row = rows.get(key)
        if row is None:
            row = rows[key] = deque()
        if is_first:
            row.appendleft(transmission)
        else:
            row.append(transmission)
        self.lengths[urgency] += 1
        return dropped

    def pop(self) -> Transmission | None:
        """Return the most urgent frame whose next hop has room, None if there is none."""
        for urgency, rows in enumerate(self._rows):
            for key in rows:
                if key is None or key.has_room() or not key.is_usable:
                    found = self._take(urgency, key)
                    if key in rows:  # its turn comes again after the others'
                        rows[key] = rows.pop(key)
                    return found
        return None

    def following(self, link: Link, urgency: int) -> Transmission | None:
        """Return the next frame to the same next hop in the same class, without taking it."""
        row = self._rows[urgency].get(link)
        return row[0] if row else None

    def take_following(self, link: Link, urgency: int) -> Transmission:
        """Take what :meth:`following` has shown."""
        return self._take(urgency, link)

    def stands(self, transmission: Transmission, *, now: float) -> bool:
        """Whether a frame that was just taken should be dropped, as its row stands still."""
        if transmission.attempts or not (transmission.is_group or transmission.entries):  # it did not wait in line
            return False
        urgency, key = transmission.packet.urgency, _key(transmission)
        judge = self._judges.get((urgency, key))
        if judge is None:
            judge = self._judges[urgency, key] = CoDel(self._target_s)
        waited_s = now - transmission.queued_at
        return judge.should_drop(waited_s, is_last=key not in self._rows[urgency], now=now)

    def remove(self, link: Link) -> Iterator[Transmission]:
        """Take out what waits for one next hop, the most urgent first."""
        for urgency, rows in enumerate(self._rows):
            row = rows.pop(link, ())
            self.lengths[urgency] -= len(row)
            self._judges.pop((urgency, link), None)
            yield from row

    def _take(self, urgency: int, key: Link | None) -> Transmission:
        rows = self._rows[urgency]
        row = rows[key]
        found = row.popleft()
        if not row:
            del rows[key]
        self.lengths[urgency] -= 1
        return found


def _key(transmission: Transmission) -> Link | None:
    return _GROUPS if transmission.is_group else transmission.entries[0].link
