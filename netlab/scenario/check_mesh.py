"""Cross-reference check of the meshes: who is in which, whom a link joins, whose settings disagree."""

from __future__ import annotations

from collections.abc import Iterator

from netlab.medium.meshes import MeshKind
from netlab.scenario.model import Scenario
from netlab.scenario.problems import Problem
from netlab.scenario.traffic import ALL

_SETTINGS = {
    "batman_adv": MeshKind.BATMAN_ADV,
    "flood": MeshKind.FLOOD,
    "wnet": MeshKind.WNET,
    "babel": MeshKind.BABEL,
}


def check_meshes(scenario: Scenario) -> Iterator[Problem]:
    """Yield every mistake in nodes' meshes."""
    yield from _settings_without_mesh(scenario)
    yield from _names_taken(scenario)
    yield from _across(scenario)
    yield from _algorithms(scenario)
    yield from _metrics(scenario)
    yield from _all_reached_by_broadcast(scenario)


def _settings_without_mesh(scenario: Scenario) -> Iterator[Problem]:
    for name, node in scenario.nodes.items():
        for key, kind in _SETTINGS.items():
            if getattr(node, key) is not None and scenario.meshes[name] is not kind:
                words = f"belongs to mesh: {kind}, and '{name}' has {_word(scenario, name)}"
                yield ("nodes", name, key), words


def _names_taken(scenario: Scenario) -> Iterator[Problem]:
    for name, kind in scenario.meshes.items():
        if kind is not None and kind.process is not None and scenario.nodes[name].process(kind.process):
            yield (
                ("nodes", name, "processes"),
                f"'{kind.process}' is the process that is the node's mesh; give yours another name:",
            )


def _across(scenario: Scenario) -> Iterator[Problem]:
    """A wire between a mesh and something else carries frames that the other end cannot read."""
    for index, link in enumerate(scenario.links):
        a, b = link.ends
        if {a, b} <= scenario.nodes.keys() and scenario.meshes[a] is not scenario.meshes[b]:
            words = f"'{a}' has {_word(scenario, a)} and '{b}' has {_word(scenario, b)}"
            yield ("links", index), f"{words}, so neither understands the other; give both the same mesh"


def _algorithms(scenario: Scenario) -> Iterator[Problem]:
    members = [name for name, kind in scenario.meshes.items() if kind is MeshKind.BATMAN_ADV]
    for other in members[1:]:
        ours, theirs = (scenario.batman_options(name).routing_algorithm for name in (members[0], other))
        if ours is not theirs:
            path = ("nodes", other, "batman_adv", "routing_algorithm")
            yield path, f"'{other}' routes by {theirs} and '{members[0]}' by {ours}; a mesh needs one and the same"


def _metrics(scenario: Scenario) -> Iterator[Problem]:
    """Every node of wnet reckons the whole path: with another metric it may send a frame back."""
    members = [name for name, kind in scenario.meshes.items() if kind is MeshKind.WNET]
    for other in members[1:]:
        ours, theirs = (scenario.wnet_settings(name).get("metric", "quality") for name in (members[0], other))
        if ours != theirs:
            path = ("nodes", other, "wnet", "metric")
            yield path, f"'{other}' goes by {theirs} and '{members[0]}' by {ours}; a mesh needs one and the same"


def _all_reached_by_broadcast(scenario: Scenario) -> Iterator[Problem]:
    """Babel routes IP packets to one node; nobody carries broadcasts and groups from network to network."""
    for index, entry in enumerate(scenario.traffic):
        if entry.to == (ALL,) and scenario.meshes.get(entry.from_) is MeshKind.BABEL:
            yield (
                ("traffic", index, "to"),
                "mesh: babel has no broadcast, which to: all needs; name the nodes",
            )


def why_apart(scenario: Scenario, a: str, b: str) -> str:
    """Why no message goes between two nodes, and what to do; continues "'a' and 'b'"."""
    if scenario.meshes[a] is not scenario.meshes[b]:
        words = f"{_word(scenario, a)} and {_word(scenario, b)}"
        return f"are in different meshes ({words}); give both the same, or none"
    if scenario.meshes[a] is None:
        return "share no link or radio, and nothing is routed; join them, or give all between them a mesh"
    return f"are in two {scenario.meshes[a]} meshes that no link or radio joins; join them"


def nobody_reached(scenario: Scenario, name: str) -> str:
    """Why `to: all` means nobody; continues "'name'"."""
    if scenario.meshes[name] is None:
        return "shares no link or radio with another udp_mesh node"
    return "has no other udp_mesh node in its mesh"


def _word(scenario: Scenario, name: str) -> str:
    return f"mesh: {scenario.meshes[name] or 'none'}"
