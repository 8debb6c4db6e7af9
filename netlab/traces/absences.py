"""When one node could not reach another, and why: a daemon was down, no link led there, or it was held offline."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable

from netlab.traces.causes import Cause, Stretch
from netlab.traces.daemon_log import Meeting
from netlab.traces.model import LinkState, Trace, killed_daemon

_FOREVER_NS = 1 << 62


def absences(trace: Trace, source: str, destination: str) -> list[Stretch]:
    """All such stretches of a run; where they overlap, the first in the list says why.

    Cuts of links and deaths of daemons are what the lab did; ``peer_absent`` and ``reconnect`` is what the source's
    daemon saw besides.
    """
    down = [*_restarts(trace, destination, source), *_restarts(trace, source, destination)]
    cut = [
        stretch
        for stretch in _cuts(trace, source, destination)
        if not _is_bypassed(trace, source, destination, stretch)
    ]
    return down + cut + list(_offline(trace, source, destination, down + cut))


def _restarts(trace: Trace, node: str, peer: str) -> list[Stretch]:
    """When a node's daemon was down, by the timeline, until its peer met its new epoch; else by what the peer saw."""
    found: list[Stretch] = []
    kills = [step.t_ns for step in trace.timeline if step.kind == "kill" and killed_daemon(step.label) == node]
    for killed_ns in kills:
        starts = [step.t_ns for step in trace.timeline if step.kind == "start_process" and step.t_ns >= killed_ns]
        started_ns = next((t for t in starts if _started(trace, t) == node), None)
        words = f"the daemon of {node} was killed at {trace.seconds(killed_ns):.3f} s"
        if started_ns is None:
            found.append(Stretch(killed_ns, _FOREVER_NS, Cause.RESTART, f"{words} and did not come back"))
            continue
        met_ns = next((m.t_ns for m in trace.daemons.meetings.get((peer, node), []) if _meets(m, killed_ns)), None)
        words += f" and started again at {trace.seconds(started_ns):.3f} s"
        words += f"; {peer} met its new epoch at {trace.seconds(met_ns):.3f} s" if met_ns else ""
        found.append(Stretch(killed_ns, max(met_ns or started_ns, started_ns), Cause.RESTART, words))
    return found or _crashes(trace, node, peer)


def _started(trace: Trace, t_ns: int) -> str | None:
    steps = (step for step in trace.timeline if step.t_ns == t_ns and step.kind == "start_process")
    return next((killed_daemon(step.label) for step in steps), None)


def _meets(meeting: Meeting, since_ns: int) -> bool:
    return meeting.is_up and meeting.t_ns >= since_ns and meeting.reason in ("restarted", "discovered")


def _crashes(trace: Trace, node: str, peer: str) -> list[Stretch]:
    found, down_ns = [], None
    for meeting in trace.daemons.meetings.get((peer, node), []):
        if not meeting.is_up:
            down_ns = meeting.t_ns
        elif meeting.reason == "restarted":
            words = (
                f"the daemon of {node} was restarted; {peer} met its new epoch at {trace.seconds(meeting.t_ns):.3f} s"
            )
            found.append(Stretch(down_ns or meeting.t_ns, meeting.t_ns, Cause.RESTART, words))
        if meeting.is_up:
            down_ns = None
    return found


def _cuts(trace: Trace, source: str, destination: str) -> list[Stretch]:
    """When no path of links that were up joined two nodes, in both directions."""
    pairs = {
        key: states
        for key, states in trace.states.items()
        if trace.is_meshed or {key[0], key[1]} == {source, destination}
    }
    if not pairs:
        return []
    times = sorted({state.t_ns for states in pairs.values() for state in states})
    found: list[Stretch] = []
    for t_ns, next_ns in zip(times, [*times[1:], _FOREVER_NS], strict=True):
        now = {key: _at(states, t_ns) for key, states in pairs.items()}
        if _joined(now, source, destination) and _joined(now, destination, source):
            continue
        is_held = any(state is not None and state.state in ("outage", "no_carrier") for state in now.values())
        cause = Cause.OUTAGE if is_held else Cause.OUT_OF_RANGE
        if found and found[-1].to_ns == t_ns and found[-1].cause is cause:
            found[-1] = Stretch(found[-1].from_ns, next_ns, cause)
        else:
            found.append(Stretch(t_ns, next_ns, cause))
    return [Stretch(s.from_ns, s.to_ns, s.cause, _cut_words(trace, s, source, destination)) for s in found]


def _at(states: list[LinkState], t_ns: int) -> LinkState | None:
    index = bisect_right(states, t_ns, key=lambda state: state.t_ns)
    return states[index - 1] if index else None


def _joined(now: dict[tuple[str, str, str], LinkState | None], source: str, destination: str) -> bool:
    reached, new = {source}, [source]
    while new:
        here = new.pop()
        for (sender, receiver, _), state in now.items():
            if sender == here and receiver not in reached and state is not None and state.state == "up":
                reached.add(receiver)
                new.append(receiver)
    return destination in reached


def _cut_words(trace: Trace, cut: Stretch, source: str, destination: str) -> str:
    what = "outage between" if cut.cause is Cause.OUTAGE else "out of range:"
    since = f"from {trace.seconds(cut.from_ns):.3f} s" if cut.from_ns > trace.t0_ns else "from the start"
    until = f"to {trace.seconds(cut.to_ns):.3f} s" if cut.to_ns < _FOREVER_NS else "to the end"
    path = ", no path of links" if trace.is_meshed else ""
    return f"{what} {source} and {destination}{path} {since} {until}"


def _is_bypassed(trace: Trace, source: str, destination: str, cut: Stretch) -> bool:
    """Whether something came through all the same: the daemon had another way, such as a bridge."""
    streams = [s.index for s in trace.streams if (s.source, s.destination) == (source, destination)]
    return any(
        cut.from_ns < entry.published_ns and entry.t_ns < cut.to_ns
        for stream in streams
        for entry in trace.delivered.get(stream, [])
    )


def _offline(trace: Trace, source: str, destination: str, known: Iterable[Stretch]) -> Iterable[Stretch]:
    """While the source held the destination offline: after the known reasons for it, the time to notice."""
    for start_ns, end_ns in _offline_times(trace.daemons.meetings.get((source, destination), [])):
        ended = [stretch.to_ns for stretch in known if stretch.from_ns < end_ns and start_ns < stretch.to_ns < end_ns]
        back = max(ended, default=None)
        until = f"{source} heard {destination} at {trace.seconds(end_ns):.3f} s"
        until = until if end_ns < _FOREVER_NS else f"{source} did not hear {destination} until the end"
        if back is None:
            words = f"{source} held {destination} offline since {trace.seconds(start_ns):.3f} s; {until}"
            words = words if start_ns else f"{source} had not met {destination} yet; {until}"
            yield Stretch(start_ns, end_ns, Cause.PEER_ABSENT, words)
        else:
            words = f"the path was back at {trace.seconds(back):.3f} s; {until}"
            yield Stretch(back, end_ns, Cause.RECONNECT, words)
            yield Stretch(start_ns, back, Cause.PEER_ABSENT, f"{source} held {destination} offline")


def _offline_times(meetings: list[Meeting]) -> Iterable[tuple[int, int]]:
    down_ns: int | None = 0
    for meeting in meetings:
        if meeting.is_up and down_ns is not None:
            yield down_ns, meeting.t_ns
            down_ns = None
        elif not meeting.is_up and down_ns is None:
            down_ns = meeting.t_ns
    if meetings and down_ns is not None:
        yield down_ns, _FOREVER_NS
