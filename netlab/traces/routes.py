"""Which relays carried the messages of each stream, and when."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass

from netlab.traces.carriage import carriage
from netlab.traces.evidence import Departure, Evidence, PacketId
from netlab.traces.model import Trace


@dataclass(slots=True)
class Route:
    """One way from a source to a destination. ``relays`` are in order, None for datagrams that did not arrive.

    ``datagrams`` carried data; ``ratio`` is their share of all between the two, 0..1. Times are CLOCK_REALTIME.
    """

    source: str
    destination: str
    relays: tuple[str, ...] | None
    datagrams: int = 0
    ratio: float = 0.0
    first_ns: int = 0
    last_ns: int = 0

    def __str__(self) -> str:
        """Name the nodes in order."""
        return "did not arrive" if self.relays is None else " > ".join((self.source, *self.relays, self.destination))


class Routes:
    """Counts datagrams with data by destination and way. A long run is taken in slices of time, in any order."""

    def __init__(self, trace: Trace) -> None:
        self._trace = trace
        self._found: dict[tuple[str, str, tuple[str, ...] | None], Route] = {}

    def take(
        self, evidence: Evidence, destinations: Collection[str], *, until_ns: int, topics: Collection[str]
    ) -> None:
        """Count what the evidence's node sent of these topics before ``until_ns``; the evidence must reach beyond."""
        tags, seen = _tags(self._trace, evidence.node), set[tuple[PacketId, str]]()
        for departure in evidence.departures:
            if departure.t_ns >= until_ns:
                return
            if self._topic(departure) not in topics:
                continue
            told = tags.get(departure.destination_tag, "")
            for destination in destinations if departure.destination_tag == 0 else {told} & set(destinations):
                if (departure.packet, destination) not in seen:
                    seen.add((departure.packet, destination))
                    self._count(evidence, departure, destination)

    def _topic(self, departure: Departure) -> str:
        if departure.topic is not None:
            return departure.topic
        return self._trace.daemons.topic_of(departure.node, departure.message_id, departure.t_ns)

    def _count(self, evidence: Evidence, departure: Departure, destination: str) -> None:
        carried = carriage(self._trace, evidence, departure.packet, destination, left_ns=departure.t_ns)
        relays = carried.relays if carried.arrived_ns is not None else None
        key = (evidence.node, destination, relays)
        route = self._found.setdefault(key, Route(*key, first_ns=departure.t_ns))
        route.datagrams += 1
        route.first_ns, route.last_ns = min(route.first_ns, departure.t_ns), max(route.last_ns, departure.t_ns)

    def result(self) -> list[Route]:
        """All ways, by source and destination; the busiest first."""
        totals: Counter[tuple[str, str]] = Counter()
        for route in self._found.values():
            totals[route.source, route.destination] += route.datagrams
        for route in self._found.values():
            route.ratio = route.datagrams / totals[route.source, route.destination]
        return sorted(self._found.values(), key=lambda route: (route.source, route.destination, -route.datagrams))


def _tags(trace: Trace, node: str) -> dict[int, str]:
    """Whose epochs the short forms are, as far as a node met them."""
    return {
        meeting.epoch & 0xFFFFFFFF: peer
        for (here, peer), meetings in trace.daemons.meetings.items()
        if here == node
        for meeting in meetings
        if meeting.epoch
    }
