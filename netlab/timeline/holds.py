"""What keeps two nodes apart, counted, so that overlapping cuts compose: up only when nothing holds down."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from netlab.timeline.entries import Pair


@dataclass(frozen=True, slots=True)
class Hold:
    """What one outage or one down phase of a flap takes away: directed pairs silently, ports by their carrier."""

    pairs: frozenset[Pair] = frozenset()
    ports: frozenset[int] = frozenset()


class Holds:
    """How many holds there are on each pair and port."""

    def __init__(self) -> None:
        self._pairs: Counter[Pair] = Counter()
        self._ports: Counter[int] = Counter()

    def take(self, hold: Hold) -> Hold:
        """Add ``hold``; return what was up until now and goes down by it."""
        fell = Hold(
            frozenset(pair for pair in hold.pairs if not self._pairs[pair]),
            frozenset(port for port in hold.ports if not self._ports[port]),
        )
        self._pairs.update(hold.pairs)
        self._ports.update(hold.ports)
        return fell

    def release(self, hold: Hold) -> Hold:
        """Remove ``hold``; return what nothing holds down any more."""
        self._pairs.subtract(hold.pairs)
        self._ports.subtract(hold.ports)
        return Hold(
            frozenset(pair for pair in hold.pairs if not self._pairs[pair]),
            frozenset(port for port in hold.ports if not self._ports[port]),
        )

    def free(self, pairs: Iterable[Pair]) -> bool:
        """Whether nothing holds any of these pairs, nor the ports at their ends."""
        return not any(self._pairs[a, b] or self._ports[a] or self._ports[b] for a, b in pairs)
