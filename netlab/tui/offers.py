"""What a person can pick: the next node or link, relays that wait, processes to kill or to start. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from netlab.lab.programs import SINK, SOURCE
from netlab.live.model import LiveModel
from netlab.tui.scene import Chosen
from netlab.tui.standing import Standing

_T = TypeVar("_T")


def next_node(model: LiveModel, chosen: Chosen, step: int) -> str | None:
    """The node ``step`` further than the chosen one, in a circle; carried ones only where there are no others."""
    names = [name for name, node in model.nodes.items() if node.active] or list(model.nodes)
    return _further(names, chosen, step)


def next_link(model: LiveModel, chosen: Chosen, step: int) -> frozenset[str] | None:
    """The link on the map ``step`` further than the chosen one, in a circle."""
    return _further([frozenset((link.a, link.b)) for link in model.shown_links()], chosen, step)


def waiting_relays(model: LiveModel, carriers: Mapping[str, str], chosen: Chosen) -> dict[str, str]:
    """The nodes that are still carried, and by whom; only the chosen one, or the chosen carrier's, if it has any."""
    waiting = {
        name: carrier for name, carrier in carriers.items() if name not in model.nodes or not model.nodes[name].active
    }
    own = {name: carrier for name, carrier in waiting.items() if chosen in (name, carrier)}
    return own or waiting


def own_processes(standing: Standing, node: str) -> list[Mapping[str, Any]]:
    """The processes of a node that are its own; the traffic is the lab's."""
    return [row for row in standing.processes_of(node) if row["process"] not in (SOURCE, SINK)]


def process_names(rows: Sequence[Mapping[str, Any]], fits: Callable[[str], bool]) -> list[str]:
    """The processes whose state fits."""
    return [str(row["process"]) for row in rows if fits(str(row["state"]))]


def told_states(rows: Sequence[Mapping[str, Any]]) -> str:
    """Which process is in which state, for a person."""
    return ", ".join(f"{row['process']} is {row['state']}" for row in rows) or "it runs nothing"


def _further(items: Sequence[_T], chosen: object, step: int) -> _T | None:
    """From the beginning (or, backwards, the end) when the chosen one is none of them."""
    if not items:
        return None
    place = next((number for number, item in enumerate(items) if item == chosen), None)
    return items[(min(0, step) if place is None else place + step) % len(items)]
