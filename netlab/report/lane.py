"""One message's way from interface to interface: what a swim-lane shows. Values only; see follow.py for where from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from netlab.medium.verdicts import Verdict
from netlab.traces.messages import MessageLife
from netlab.traces.model import EVERYBODY, Fragment, Interface, Trace

_MARGIN_NS = 250_000_000  # acknowledgements come soon after the delivery
_ARRIVED = (Verdict.DELIVERED, Verdict.CORRUPTED, Verdict.DUPLICATED, Verdict.REORDERED)


class Cargo(StrEnum):
    """What a packet carries."""

    FIRST = "fragment"
    AGAIN = "retransmission"
    COPY = "copy"
    ACK = "acknowledgement"


@dataclass(frozen=True, slots=True)
class Flight:
    """A packet on one hop. ``arrived_ns`` is None where it never came, ``lost`` then says why as far as is known."""

    cargo: Cargo
    sent_ns: int
    sender: Interface
    receiver: Interface
    arrived_ns: int | None
    lost: str = ""
    fragments: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Lane:
    """A message's whole life. ``interfaces`` are in the order of its way; ``is_opaque``: its packets are sealed."""

    life: MessageLife
    interfaces: tuple[Interface, ...]
    flights: tuple[Flight, ...]
    is_opaque: bool

    @property
    def start_ns(self) -> int:
        """The publish call."""
        return self.life.published.t_ns

    @property
    def end_ns(self) -> int:
        """The last thing that is known of it."""
        ends = [flight.arrived_ns or flight.sent_ns for flight in self.flights]
        return max([self.start_ns, *ends, *([self.life.delivery.t_ns] if self.life.delivery else [])])

    def count(self, cargo: Cargo, *, lost: bool = False) -> int:
        """How many packets of a kind left their first interface, or how many were lost anywhere."""
        return sum(
            flight.cargo is cargo and (flight.arrived_ns is None if lost else flight.sender[0] == self._first(cargo))
            for flight in self.flights
        )

    def _first(self, cargo: Cargo) -> str:
        stream = self.life.stream
        return stream.destination if cargo is Cargo.ACK else stream.source


def chosen_life(lives: Iterable[MessageLife], topic: str | None, seq: int | None) -> MessageLife | None:
    """Return the message ``topic#seq``, the slowest one if several streams have it; None if there is none.

    Without a topic: the slowest delivered message of the most urgent priority of which anything was delivered.
    """
    if topic is not None:
        found = [life for life in lives if life.stream.topic == topic and life.published.seq == seq]
        return max(found, key=_took_s, default=None)
    delivered = [life for life in lives if life.delivery is not None]
    most_urgent = min((life.stream.priority for life in delivered), default=None)
    return max((life for life in delivered if life.stream.priority == most_urgent), key=_took_s, default=None)


def _took_s(life: MessageLife) -> float:
    return float("inf") if life.delivery is None else life.delivery.latency_s


def fragments_of(trace: Trace, life: MessageLife) -> list[Fragment]:
    """All transmissions of a message to its destination."""
    message = (life.published.publication, life.published.seq)
    return [
        fragment
        for fragment in trace.fragments.get(life.stream.source, [])
        if fragment.message == message and fragment.destination in (life.stream.destination, EVERYBODY, "")
    ]


def window_ns(trace: Trace, life: MessageLife) -> tuple[int, int]:
    """From when to when packets matter."""
    ends = [fragment.t_ns for fragment in fragments_of(trace, life)]
    ends += [life.delivery.t_ns] if life.delivery is not None else []
    return life.published.t_ns, max([life.published.t_ns, *ends]) + _MARGIN_NS


def busy_spans(lane: Lane, *, most: int = 3) -> list[tuple[int, int]]:
    """When something happened, as (from, to) in CLOCK_REALTIME: the whole life without its longest idle times.

    At most ``most`` spans; a time with nothing under way is left out only if it is longer than a quarter of the whole.
    """
    busy = [(flight.sent_ns, flight.arrived_ns or flight.sent_ns) for flight in lane.flights]
    busy += [(lane.start_ns, lane.start_ns)]
    busy += [(lane.life.delivery.t_ns, lane.life.delivery.t_ns)] if lane.life.delivery else []
    whole = lane.end_ns - lane.start_ns
    idle: list[tuple[int, int]] = []
    reached = lane.start_ns
    for start, end in sorted(busy):
        if start - reached > whole / 4:
            idle.append((reached, start))
        reached = max(reached, end)
    cuts = sorted(sorted(idle, key=lambda gap: gap[0] - gap[1])[: most - 1])
    edges = [lane.start_ns, *(edge for cut in cuts for edge in cut), reached]
    return list(zip(edges[::2], edges[1::2], strict=True))


def thinned_flights(flights: Sequence[Flight], *, columns: int) -> list[Flight]:
    """Leave out first transmissions and acknowledgements where they are dense; whatever went wrong stays.

    Of each kind and hop the first and the last in each of ``columns`` parts of the time are kept.
    """
    if len(flights) <= 2 * columns:
        return list(flights)
    start_ns = min(flight.sent_ns for flight in flights)
    span_ns = max(flight.sent_ns for flight in flights) - start_ns + 1
    ends: dict[tuple[object, ...], tuple[int, int]] = {}
    for number, flight in enumerate(flights):
        key = (flight.cargo, flight.sender, flight.receiver, (flight.sent_ns - start_ns) * columns // span_ns)
        ends[key] = (ends.get(key, (number, number))[0], number)
    kept = {number for pair in ends.values() for number in pair}
    return [
        flight
        for number, flight in enumerate(flights)
        if number in kept or flight.arrived_ns is None or flight.cargo in (Cargo.AGAIN, Cargo.COPY)
    ]
