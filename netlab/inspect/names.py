"""Names that a person chose by: one that the capture does not know is told, and not only answered by nothing."""

from __future__ import annotations

import json

from netlab.capture.reader import Capture
from netlab.capture.records import Kind
from netlab.capture.view import Filter
from netlab.traces.model import EVERYBODY

_OF_NODES = {Kind.PACKET, Kind.LOG, Kind.EVENT, Kind.PUBLISHED, Kind.RECEIVED}


def unknown_names(capture: Capture, chosen: Filter) -> list[str]:
    """What to tell a person whose choice has names that the capture does not know, with those that it does."""
    told = []
    nodes, topics = _nodes(capture), {str(row["topic"]) for row in _rows(capture, "streams") if "topic" in row}
    for option, name in (("--node", chosen.node), ("--peer", chosen.peer)):
        if nodes and name not in (None, EVERYBODY, *nodes) and not _is_address(str(name)):
            told.append(f"{option} {name}: no such node in this capture; nodes are {', '.join(sorted(nodes))}")
    if topics and chosen.topic not in (None, *topics):
        told.append(f"--topic {chosen.topic}: not of this run's traffic; its topics are {', '.join(sorted(topics))}")
    return told


def _is_address(name: str) -> bool:
    """Conversations with hosts that are no nodes are under their addresses."""
    return "." in name or ":" in name


def _nodes(capture: Capture) -> set[str]:
    rows = [*_rows(capture, "ports"), *_rows(capture, "meshes"), *_rows(capture, "streams")]
    told = {str(row[key]) for row in rows for key in ("node", "source", "destination") if row.get(key)}
    named = (topic.name.split("/") for topic in capture.topics if topic.kind in _OF_NODES)
    return told | {parts[1] for parts in named if len(parts) > 2}


def _rows(capture: Capture, key: str) -> list[dict[str, object]]:
    """A list in the run's metadata; empty where it is missing or damaged."""
    try:
        rows = json.loads(capture.metadata.get(key, "[]"))
    except ValueError:
        return []
    return [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
