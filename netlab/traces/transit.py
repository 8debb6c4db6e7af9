"""What a frame's time between nodes went to: the link's queue or the channel, its length, the link's delay, relays."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence

from netlab.traces.carriage import Carriage, Hop
from netlab.traces.causes import Cause, Stretch
from netlab.traces.evidence import Departure, Evidence, PacketId
from netlab.traces.model import NS_PER_S, LinkState, Trace
from netlab.traces.waiting import Ahead, Naming, behind

_LOOK_BACK = 2000  # departures
_NO_QUEUE_NS = 250_000  # less than this is the emulation's own time


def transit(
    trace: Trace, evidence: Evidence, carried: Carriage, departure: Departure, naming: Naming
) -> Iterator[Stretch]:
    """Divide the time from a datagram's departure to its arrival; nothing if it did not arrive."""
    if carried.arrived_ns is None:
        return
    at_ns, packet = departure.t_ns, departure.packet
    for hop in carried.hops:
        if hop.arrived_ns is None or hop.left_ns < at_ns:
            continue
        yield Stretch(at_ns, hop.left_ns, Cause.RELAY, f"inside {hop.sender[0]}")
        yield from _hop(trace, evidence, hop, hop.arrived_ns, packet, naming)
        at_ns = hop.arrived_ns
    what = f"inside {carried.hops[-1].receiver[0]}" if carried.hops else "on the way"
    yield Stretch(at_ns, carried.arrived_ns, Cause.RELAY if carried.hops else Cause.UNEXPLAINED, what)


def _hop(
    trace: Trace, evidence: Evidence, hop: Hop, arrived_ns: int, packet: PacketId, naming: Naming
) -> Iterator[Stretch]:
    whole_ns = arrived_ns - hop.left_ns
    state = _state(trace, hop)
    delay_ns, own_ns = _inherent(state, hop)
    if delay_ns is None:  # a radio: nobody says how long a frame takes, so the quickest alike does
        own_ns, delay_ns = min(whole_ns, _quickest_ns(evidence, hop, whole_ns)), 0
    propagation_ns = min(delay_ns, whole_ns)
    own_ns = min(own_ns, whole_ns - propagation_ns)
    queue_ns = whole_ns - propagation_ns - own_ns
    if queue_ns < _NO_QUEUE_NS:
        own_ns, queue_ns = own_ns + queue_ns, 0
    name = f"{'/'.join(hop.sender)} > {'/'.join(hop.receiver)}"
    queue_end, own_end = hop.left_ns + queue_ns, hop.left_ns + queue_ns + own_ns
    if queue_ns:
        cause, words = _why_waiting(hop, naming(d for d in _in_front(evidence, hop) if d.packet != packet))
        yield Stretch(hop.left_ns, queue_end, cause, f"{words} at {name}")
    rate = f" at {state.rate_bps / 1e6:g} Mbit/s" if state is not None and state.rate_bps else ""
    yield Stretch(queue_end, own_end, Cause.TRANSMISSION, f"{hop.frame_bytes} B on {name}{rate}")
    yield Stretch(own_end, arrived_ns, Cause.PROPAGATION, f"on {name}")


def _state(trace: Trace, hop: Hop) -> LinkState | None:
    segment = trace.segments.get(hop.sender, "")
    states = trace.states.get((hop.sender[0], hop.receiver[0], segment), [])
    index = bisect_right(states, hop.left_ns, key=lambda state: state.t_ns)
    return states[index - 1] if index else None


def _inherent(state: LinkState | None, hop: Hop) -> tuple[int | None, int]:
    """Propagation and serialisation in ns; None: nobody says."""
    if state is None or state.delay_s is None or hop.attempts:
        return None, 0
    own_s = hop.frame_bytes * 8 / state.rate_bps if state.rate_bps else 0.0
    return round((state.delay_s + state.jitter_s) * NS_PER_S), round(own_s * NS_PER_S)


def frame_ns(trace: Trace, evidence: Evidence, packet: PacketId, fallback_ns: int) -> int:
    """How long a datagram takes on its sender's link by itself; ``fallback_ns`` where nobody says, as of radios."""
    for seen in evidence.sightings.get(packet, []):
        segment = trace.segments.get(seen.interface)
        if seen.is_outbound and seen.interface[0] == evidence.node and segment is not None:
            for (sender, _, name), states in trace.states.items():
                if (sender, name) == (evidence.node, segment) and states[0].delay_s is not None:
                    rate_bps = trace.rate_bps(seen.interface, seen.t_ns)
                    return round(seen.frame_bytes * 8 / rate_bps * NS_PER_S) if rate_bps else 0
    return fallback_ns


def _quickest_ns(evidence: Evidence, hop: Hop, whole_ns: int) -> int:
    """The least time that a frame at least as long took on this hop."""
    times = [whole_ns]
    for seen in evidence.sightings.values():
        left = [s for s in seen if s.is_outbound and s.interface == hop.sender and s.frame_bytes >= hop.frame_bytes]
        got = [s for s in seen if not s.is_outbound and s.interface == hop.receiver]
        times += [b.t_ns - a.t_ns for a in left for b in got if a.crc32 == b.crc32 and b.t_ns > a.t_ns]
    return min(times)


def _why_waiting(hop: Hop, in_front: Sequence[Ahead]) -> tuple[Cause, str]:
    """What a frame waited for in a link, and the words for it."""
    retries = f"sent {hop.attempts} times by the radio" if hop.attempts > 1 else ""
    if in_front:
        return Cause.LINK_QUEUE, f"{behind(in_front)}{f', {retries}' if retries else ''}"
    return (
        (Cause.RADIO_RETRIES, retries) if retries else (Cause.LINK_QUEUE, "for the channel, or behind others' frames")
    )


def _in_front(evidence: Evidence, hop: Hop) -> list[Departure]:
    """What had left the sender before and arrived after it: it was still in the link."""
    if hop.sender[0] != evidence.node:
        return []
    end = bisect_right(evidence.departures, hop.left_ns - 1, key=lambda d: d.t_ns)
    front = []
    for departure in reversed(evidence.departures[max(0, end - _LOOK_BACK) : end]):
        seen = evidence.sightings.get(departure.packet, [])
        arrived = [s.t_ns for s in seen if s.interface == hop.receiver and not s.is_outbound]
        left = any(s.interface == hop.sender and s.is_outbound for s in seen)
        if left and arrived and min(arrived) > hop.left_ns:
            front.append(departure)
        elif left and arrived:
            break  # first in, first out
    return front
