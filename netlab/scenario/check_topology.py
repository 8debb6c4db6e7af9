"""Cross-reference check of what stands still: node names, links, the radio's table."""

from __future__ import annotations

from collections.abc import Iterator

from netlab.scenario.base import suggestion
from netlab.scenario.check_mesh import check_meshes, why_apart
from netlab.scenario.document import Path
from netlab.scenario.generate import MAX_LINKS
from netlab.scenario.links import Ends
from netlab.scenario.model import Scenario
from netlab.scenario.problems import Problem
from netlab.scenario.radio import Radio
from netlab.scenario.recover import Doubt


class Names:
    """The nodes that may be referred to."""

    def __init__(self, scenario: Scenario, doubt: Doubt) -> None:
        self._known = doubt.nodes or tuple(scenario.nodes)
        self._all = frozenset(self._known)
        self.certain = "nodes" not in doubt.sections and "generate" not in doubt.sections

    def complaint(self, name: str) -> str | None:
        """What is wrong with a reference to ``name``, or None."""
        if name in self._all or not self.certain:
            return None
        return f"node '{name}' is not defined; {suggestion(name, self._known, 'nodes are')}"

    def check_ends(self, ends: Ends, path: Path) -> Iterator[Problem]:
        """Complain about both ends of a pair: unknown nodes, or a pair of a node with itself."""
        a, b = ends.ends
        keys: tuple[Path, Path] = (("from",), ("to",)) if ends.between is None else (("between", 0), ("between", 1))
        for name, key in zip((a, b), keys, strict=True):
            if complaint := self.complaint(name):
                yield (*path, *key), complaint
        if a == b:
            yield (*path, *keys[1]), f"joins '{a}' with itself; name two nodes"


def check_topology(scenario: Scenario, doubt: Doubt) -> Iterator[Problem]:
    """Yield every mistake in how nodes, links and radios refer to one another."""
    names = Names(scenario, doubt)
    yield from _node_names(scenario)
    yield from _links(scenario, names)
    yield from check_meshes(scenario)
    yield from _neighbours(scenario, names)
    yield from _team(scenario, names)
    if scenario.radio is not None:
        yield from _radio_pairs(scenario, scenario.radio, names)
        yield from _radio_trace(scenario, scenario.radio, names)


def _neighbours(scenario: Scenario, names: Names) -> Iterator[Problem]:
    """Fixed neighbours of udp_mesh: nodes that exist, and those of one node joined to it."""
    for position, name in enumerate(scenario.udp_mesh.neighbours or ()):
        if complaint := names.complaint(name):
            yield ("udp_mesh", "neighbours", position), complaint
    for node, settings in ((name, node.udp_mesh) for name, node in scenario.nodes.items()):
        for position, name in enumerate((settings.neighbours if settings else None) or ()):
            path: Path = ("nodes", node, "udp_mesh", "neighbours", position)
            if complaint := names.complaint(name):
                yield path, complaint
            elif name in scenario.nodes and name != node and names.certain and not _is_next_to(scenario, node, name):
                yield path, f"'{node}' and '{name}' {why_apart(scenario, node, name)}"


def _team(scenario: Scenario, names: Names) -> Iterator[Problem]:
    """Teams of udp_mesh: nodes that exist, near or far."""
    own = [(("nodes", name, "udp_mesh"), node.udp_mesh) for name, node in scenario.nodes.items()]
    for path, settings in ((("udp_mesh",), scenario.udp_mesh), *own):
        for position, name in enumerate((settings.team if settings else None) or ()):
            if complaint := names.complaint(name):
                yield (*path, "team", position), complaint


def _is_next_to(scenario: Scenario, a: str, b: str) -> bool:
    return bool(scenario.joined(a, b)) if scenario.meshes[a] is None else scenario.reaches(a, b)


def _node_names(scenario: Scenario) -> Iterator[Problem]:
    lowered: dict[str, str] = {}
    for name in scenario.nodes:
        other = lowered.setdefault(name.lower(), name)
        if other != name:
            yield ("nodes", name), f"differs from '{other}' only by case, which hostnames ignore; rename one"
        base, _, port = name.rpartition("-")
        if base in scenario.nodes and (port.startswith(("eth", "radio", "bat")) and port[-1].isdigit()):
            yield ("nodes", name), f"'{name}' is also how an interface of '{base}' is called; rename the node"


def _links(scenario: Scenario, names: Names) -> Iterator[Problem]:
    between: dict[frozenset[str], int] = {}
    directed: dict[tuple[str, str], int] = {}
    for index, link in enumerate(scenario.links):
        yield from names.check_ends(link, ("links", index))
        a, b = link.ends
        first = (
            directed.setdefault((a, b), index)
            if link.between is None
            else between.setdefault(frozenset(link.ends), index)
        )
        if first != index:
            arrow = "->" if link.between is None else "-"
            yield ("links", index), f"link {a} {arrow} {b} is defined twice (first by links[{first}]); remove one"
        elif link.between is None and (complaint := _refined(scenario, index)):
            yield ("links", index), complaint
    if len(between) + len(directed) > MAX_LINKS:
        yield ("links",), f"{len(scenario.links):,} links; the most is {MAX_LINKS:,}"


def _refined(scenario: Scenario, index: int) -> str | None:
    """The inconsistency of a one-way entry together with the link that it refines."""
    link = scenario.links[index]
    base = next((other for other in scenario.links if other.between and set(other.between) == set(link.ends)), None)
    return (link if base is None else link.laid_over(base)).inconsistency()


def _radio_pairs(scenario: Scenario, radio: Radio, names: Names) -> Iterator[Problem]:
    seen: dict[tuple[str, str], int] = {}
    for index, pair in enumerate(radio.propagation.pairs):
        path: Path = ("radio", "propagation", "pairs", index)
        yield from names.check_ends(pair, path)
        yield from _without_radio(scenario, pair.ends, path)
        first = min((seen.setdefault(direction, index) for direction in pair.directions), default=index)
        if first != index:
            yield path, f"{' and '.join(pair.ends)} are in the table twice (first in pairs[{first}]); remove one"
        if complaint := pair.laid_over(radio).inconsistency():
            yield path, complaint
    default = radio.propagation.default
    if default is not None and (complaint := default.laid_over(radio).inconsistency()):
        yield ("radio", "propagation", "default"), complaint


def _without_radio(scenario: Scenario, ends: tuple[str, str], path: Path) -> Iterator[Problem]:
    for name in ends:
        if name in scenario.nodes and scenario.nodes[name].radio == "none":
            yield path, f"'{name}' has no radio (nodes.{name}.radio is none); remove the pair or that key"


def _radio_trace(scenario: Scenario, radio: Radio, names: Names) -> Iterator[Problem]:
    trace = radio.propagation.file
    if trace is None:
        return
    reported: set[str] = set()
    for row in trace.rows:
        for name in (row.sender, row.receiver):
            complaint = names.complaint(name)
            if complaint is None and name in scenario.nodes and scenario.nodes[name].radio == "none":
                complaint = f"'{name}' has no radio (nodes.{name}.radio is none)"
            if complaint and name not in reported:
                reported.add(name)
                yield ("radio", "propagation", "file"), f"{trace.name}:{row.line}: {complaint}"
        if row.sender == row.receiver:
            yield ("radio", "propagation", "file"), f"{trace.name}:{row.line}: joins '{row.sender}' with itself"
