"""Cross-reference check of what happens: traffic, events, expectations."""

from __future__ import annotations

from collections.abc import Iterator

from netlab.scenario.base import suggestion
from netlab.scenario.check_mesh import nobody_reached, why_apart
from netlab.scenario.check_topology import Names
from netlab.scenario.document import Path
from netlab.scenario.events import Event, Flap, LinkChange, Outage
from netlab.scenario.expect import (
    AnyExpectation,
    NodeQuery,
    PairQuery,
    PriorityInversionsExpectation,
    RerouteExpectation,
    StreamQuery,
)
from netlab.scenario.model import Scenario
from netlab.scenario.problems import Problem
from netlab.scenario.quantities import DURATION
from netlab.scenario.recover import Doubt
from netlab.scenario.traffic import ALL, Stream, Traffic

_AFTER_THE_END = "is not before the end"


def check_activity(scenario: Scenario, doubt: Doubt) -> Iterator[Problem]:
    """Yield every mistake in what traffic, events and expectations refer to."""
    check = _Activity(scenario, doubt)
    yield from check.traffic()
    yield from check.events()
    yield from check.expectations()


def is_after_the_end(problem: Problem) -> bool:
    """Whether a problem is that an event would come after the end."""
    path, message = problem
    return path[:1] == ("events",) and path[2:] == ("at",) and _AFTER_THE_END in message


class _Activity:
    def __init__(self, scenario: Scenario, doubt: Doubt) -> None:
        self._scenario = scenario
        self._doubt = doubt
        self._names = Names(scenario, doubt)
        self._streams = scenario.streams()
        self._paths_certain = self._names.certain and not {"links", "radio"} & doubt.sections

    def _known(self, *names: str) -> bool:
        """Whether these nodes are defined and their blocks sound, so that more can be said about them."""
        return all(name in self._scenario.nodes for name in names)

    def traffic(self) -> Iterator[Problem]:
        for index, item in enumerate(self._scenario.traffic):
            path: Path = ("traffic", index)
            yield from self._endpoint(item.from_, (*path, "from"))
            yield from self._other_settings(index, item)
            if item.to == (ALL,):
                if self._known(item.from_) and self._paths_certain and not self._scenario.destinations(item):
                    yield (*path, "to"), f"'{item.from_}' {nobody_reached(self._scenario, item.from_)}"
                continue
            for position, name in enumerate(item.to):
                to_path: Path = (*path, "to", position) if len(item.to) > 1 else (*path, "to")
                yield from self._endpoint(name, to_path)
                if name == item.from_:
                    yield to_path, f"'{name}' sends to itself; name another node"
                elif self._apart(item.from_, name):
                    yield to_path, f"'{item.from_}' and '{name}' {why_apart(self._scenario, item.from_, name)}"

    def _other_settings(self, index: int, item: Traffic) -> Iterator[Problem]:
        """A topic's settings belong to the sender's daemon, so they cannot differ from entry to entry."""
        for earlier, other in enumerate(self._scenario.traffic[:index]):
            if (other.from_, other.topic) == (item.from_, item.topic) and other.topic_settings != item.topic_settings:
                yield (
                    ("traffic", index, "topic"),
                    f"'{item.from_}' publishes '{item.topic}' with other settings in traffic[{earlier}]; "
                    "make them equal, or use another topic",
                )
                return

    def _endpoint(self, name: str, path: Path) -> Iterator[Problem]:
        if complaint := self._names.complaint(name):
            yield path, complaint
        elif self._known(name) and self._scenario.nodes[name].process("udp_mesh") is None:
            yield path, f"node '{name}' runs no udp_mesh to carry traffic; add processes: [udp_mesh]"

    def _apart(self, a: str, b: str) -> bool:
        return self._known(a, b) and self._paths_certain and not self._scenario.reaches(a, b)

    def events(self) -> Iterator[Problem]:
        for index, event in enumerate(self._scenario.events):
            path: Path = ("events", index)
            duration_s = self._scenario.duration_s
            if event.at_s >= duration_s and "duration" not in self._doubt.sections:
                yield (
                    (*path, "at"),
                    f"{DURATION.format(event.at_s)} {_AFTER_THE_END}; duration is {DURATION.format(duration_s)}",
                )
            for kind in ("outage", "flap", "link"):
                part: Outage | Flap | LinkChange | None = getattr(event, kind)
                if part is not None:
                    yield from self._path_event(part, (*path, kind))
            yield from self._kill(event, path)

    def _path_event(self, part: Outage | Flap | LinkChange, path: Path) -> Iterator[Problem]:
        ends_problems = list(self._names.check_ends(part, path))
        yield from ends_problems
        a, b = part.ends
        if ends_problems or not self._known(a, b) or not self._paths_certain:
            return
        media = self._scenario.joined(a, b)
        if not media:
            yield path, f"'{a}' and '{b}' share no link or radio; {self._neighbours(a)}"
        elif part.over is not None and part.over not in media:
            yield (*path, "over"), f"'{a}' and '{b}' share no {part.over}; remove over:"
        elif isinstance(part, LinkChange) and part.over is None and len(media) > 1:
            yield path, f"'{a}' and '{b}' share a wire and a radio; say which with over: wire or over: radio"

    def _neighbours(self, name: str) -> str:
        others = [other for other in self._scenario.nodes if other != name and self._scenario.joined(name, other)]
        return f"'{name}' is joined to {', '.join(others[:20])}" if others else f"'{name}' is joined to nobody"

    def _kill(self, event: Event, path: Path) -> Iterator[Problem]:
        kill = event.kill
        if kill is None:
            return
        if complaint := self._names.complaint(kill.node):
            yield (*path, "kill", "node"), complaint
        if not self._known(kill.node):
            return
        process = self._scenario.nodes[kill.node].process(kill.process)
        known = self._scenario.process_names(kill.node)
        if kill.process not in known:
            hint = suggestion(kill.process, known, "its processes are") if known else "it runs no process"
            yield (*path, "kill", "process"), f"node '{kill.node}' runs no process '{kill.process}'; {hint}"
        elif process is not None and process.restart == "always" and event.restart_s is not None:
            yield (*path, "restart"), f"'{process.name}' restarts by itself (restart: always); remove one of the two"

    def expectations(self) -> Iterator[Problem]:
        for index, entry in enumerate(self._scenario.expect):
            path: Path = ("expect", index, entry.question)
            query = getattr(entry, entry.question)
            if isinstance(query, StreamQuery):
                yield from self._stream_query(query, path)
            elif isinstance(query, PairQuery):
                yield from self._pair_query(query, entry, path)
            elif isinstance(query, NodeQuery):
                yield from self._node_query(query, entry, path)

    def _stream_query(self, query: StreamQuery, path: Path) -> Iterator[Problem]:
        unknown = False
        for key, name in (("from", query.from_), ("to", query.to)):
            if name is not None and (complaint := self._names.complaint(name)):
                unknown = True
                yield (*path, key), complaint
        if unknown or {"traffic", "nodes", "generate", "links", "radio"} & self._doubt.sections:
            return
        topics = list(dict.fromkeys(stream.topic for stream in self._streams))
        if query.topic not in topics:
            hint = suggestion(query.topic, topics, "topics are") if topics else "there is no traffic"
            yield (*path, "topic"), f"no traffic has topic '{query.topic}'; {hint}"
        elif not any(_asked(query, stream) for stream in self._streams):
            flows = [f"{s.source} -> {s.destination}" for s in self._streams if s.topic == query.topic]
            yield path, f"no stream of '{query.topic}' goes that way; it goes {', '.join(flows[:10])}"

    def _pair_query(self, query: PairQuery, entry: AnyExpectation, path: Path) -> Iterator[Problem]:
        complaints = [self._names.complaint(name) for name in query.between]
        for position, complaint in enumerate(complaints):
            if complaint:
                yield (*path, "between", position), complaint
        a, b = query.between
        if any(complaints) or not self._known(a, b):
            return
        meshed = self._scenario.meshes[a] is not None and self._scenario.reaches(a, b)
        if isinstance(entry, RerouteExpectation):
            yield from self._reroute_query(a, b, path, meshed=meshed)
        radio = self._scenario.radio
        if "events" in self._doubt.sections or (radio and (radio.propagation.file or radio.propagation.physics)):
            return
        cuts = [part for event in self._scenario.events if (part := event.outage or event.flap)]
        if not any(meshed or set(part.ends) == {a, b} for part in cuts):
            ever = "cut" if isinstance(entry, RerouteExpectation) else "restored"
            yield path, f"nothing is ever {ever} between '{a}' and '{b}'; add an outage or a flap to events"

    def _reroute_query(self, a: str, b: str, path: Path, *, meshed: bool) -> Iterator[Problem]:
        if not meshed and self._paths_certain:
            yield path, f"nothing is routed between '{a}' and '{b}'; give them, and what joins them, a mesh:"
        elif "traffic" not in self._doubt.sections and not self._traffic_between(a, b):
            yield path, f"no traffic goes between '{a}' and '{b}', so nothing shows a reroute; add some"

    def _traffic_between(self, a: str, b: str) -> bool:
        return any({stream.source, stream.destination} == {a, b} for stream in self._streams)

    def _node_query(self, query: NodeQuery, entry: AnyExpectation, path: Path) -> Iterator[Problem]:
        needs_traffic = isinstance(entry, PriorityInversionsExpectation) and "traffic" not in self._doubt.sections
        if complaint := self._names.complaint(query.at):
            yield (*path, "at"), complaint
        elif self._known(query.at) and self._scenario.nodes[query.at].process("udp_mesh") is None:
            yield (*path, "at"), f"node '{query.at}' runs no udp_mesh; add processes: [udp_mesh] or ask another node"
        elif needs_traffic and not any(stream.source == query.at for stream in self._streams):
            yield (*path, "at"), f"node '{query.at}' sends no traffic, so it cannot invert priorities"


def _asked(query: StreamQuery, stream: Stream) -> bool:
    return (
        query.topic == stream.topic and query.from_ in (None, stream.source) and query.to in (None, stream.destination)
    )
