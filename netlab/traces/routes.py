"""Which relays carried the messages of each stream, and when."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from netlab.traces.carriage import carriage
from netlab.traces.evidence import Evidence
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


def routes(trace: Trace, evidence: Evidence, destinations: Collection[str]) -> list[Route]:
    """Count the datagrams with data that the evidence's node sent, by destination and way; the busiest way first."""
    tags = _tags(trace, evidence.node)
    found: dict[tuple[str, tuple[str, ...] | None], Route] = {}
    seen: set[tuple[tuple[int, int], str]] = set()
    for departure in evidence.departures:
        told = tags.get(departure.destination_tag)
        for destination in destinations if departure.destination_tag == 0 else [told]:
            if destination is None or destination not in destinations or (departure.packet, destination) in seen:
                continue
            seen.add((departure.packet, destination))
            carried = carriage(trace, evidence, departure.packet, destination, left_ns=departure.t_ns)
            relays = carried.relays if carried.arrived_ns is not None else None
            route = found.setdefault((destination, relays), Route(evidence.node, destination, relays))
            route.datagrams += 1
            route.first_ns, route.last_ns = route.first_ns or departure.t_ns, departure.t_ns
    totals: dict[str, int] = {}
    for route in found.values():
        totals[route.destination] = totals.get(route.destination, 0) + route.datagrams
    for route in found.values():
        route.ratio = route.datagrams / totals[route.destination]
    return sorted(found.values(), key=lambda route: (route.destination, -route.datagrams))


def _tags(trace: Trace, node: str) -> dict[int, str]:
    """Whose epochs the short forms are, as far as a node met them."""
    return {
        meeting.epoch & 0xFFFFFFFF: peer
        for (here, peer), meetings in trace.daemons.meetings.items()
        if here == node
        for meeting in meetings
        if meeting.epoch
    }
