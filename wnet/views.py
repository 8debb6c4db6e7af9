"""A mesh's snapshot as plain values for JSON, as text for people, and as a graph for Graphviz. Pure."""

from __future__ import annotations

import dataclasses
import ipaddress
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from wnet.core.snapshot import NodeState, Snapshot

Row = Mapping[str, Any]


def answer(word: str, snapshot: Snapshot) -> dict[str, Any]:
    """The object for ``topology``, ``links``, ``routes`` or ``stats``; MACs and addresses are text in it."""
    names = {node.mac: _addresses(node) for node in snapshot.nodes}
    head = {"mac": snapshot.mac.hex(":"), "addresses": names.get(snapshot.mac, [])}
    return head | _PARTS[word](snapshot)


def _addresses(node: NodeState) -> list[str]:
    return [str(ipaddress.IPv4Address(address)) for address in node.addresses]


def _topology(snapshot: Snapshot) -> dict[str, Any]:
    nodes = [row(node) | {"addresses": _addresses(node)} for node in snapshot.nodes]
    return {"nodes": nodes, "edges": [row(edge) for edge in snapshot.edges]}


def _links(snapshot: Snapshot) -> dict[str, Any]:
    return {"links": [row(link) for link in snapshot.links], "addresses_by_mac": _by_mac(snapshot)}


def _routes(snapshot: Snapshot) -> dict[str, Any]:
    return {"routes": [row(route) for route in snapshot.routes], "addresses_by_mac": _by_mac(snapshot)}


def _stats(snapshot: Snapshot) -> dict[str, Any]:
    groups = [group.hex(":") for group in snapshot.groups]
    return {"counts": dict(snapshot.counts), "queued": list(snapshot.queued), "groups": groups}


def _by_mac(snapshot: Snapshot) -> dict[str, list[str]]:
    return {node.mac.hex(":"): _addresses(node) for node in snapshot.nodes}


_PARTS: dict[str, Callable[[Snapshot], dict[str, Any]]] = {
    "topology": _topology,
    "links": _links,
    "routes": _routes,
    "stats": _stats,
}


def row(state: Any) -> dict[str, Any]:
    """A state of a snapshot as a row."""
    return {field.name: _plain(getattr(state, field.name)) for field in dataclasses.fields(state)}


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex(":")
    return [_plain(part) for part in value] if isinstance(value, tuple) else value


def table(word: str, told: Row) -> str:
    """The text for people of what :func:`answer` gave."""
    columns = _COLUMNS[word]
    names = told.get("addresses_by_mac") or {node["mac"]: node["addresses"] for node in told.get("nodes", [])}
    rows = told["edges" if word == "topology" else word]
    cells = [list(columns)] + [[show(entry, names) for show in columns.values()] for entry in rows]
    widths = [max(len(line[place]) for line in cells) for place in range(len(columns))]
    return "\n".join(
        "  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip() for line in cells
    )


def _name(mac: str | None, names: Mapping[str, Sequence[str]]) -> str:
    """A node by its address where it has told one."""
    return "-" if mac is None else (names.get(mac) or [mac])[0]


def _figure(value: float | None, unit: str, scale: float = 1.0, digits: int = 1) -> str:
    return "-" if value is None else f"{value * scale:.{digits}f}{unit}"


_Show = Callable[[Row, Mapping[str, Sequence[str]]], str]
_COLUMNS: dict[str, dict[str, _Show]] = {
    "links": {
        "NEIGHBOUR": lambda r, names: _name(r["neighbour"], names),
        "MEMBER": lambda r, _: str(r["member"]),
        "STATE": lambda r, _: "up" if r["is_usable"] else "down",
        "RELAY": lambda r, _: "mpr" if r["is_mpr"] else "-",
        "LOSS IN": lambda r, _: _figure(r["loss_in_ratio"], " %", 100),
        "LOSS OUT": lambda r, _: _figure(r["loss_out_ratio"], " %", 100),
        "SNR IN": lambda r, _: _figure(r["snr_in_db"], " dB"),
        "SNR OUT": lambda r, _: _figure(r["snr_out_db"], " dB"),
        "RTT": lambda r, _: _figure(r["srtt_s"], " ms", 1e3),
        "RATE": lambda r, _: _figure(r["rate_bps"], " Mbit/s", 1e-6),
        "COST": lambda r, _: _figure(r["cost_out"], "", digits=3),
        "HEARD": lambda r, _: _figure(r["heard_s"], " s ago"),
    },
    "routes": {
        "DESTINATION": lambda r, names: _name(r["destination"], names),
        "NEXT HOP": lambda r, names: _name(r["next_hop"], names),
        "HOPS": lambda r, _: str(r["hops"]),
        "COST": lambda r, _: _figure(r["cost"], "", digits=3),
        "ALTERNATES": lambda r, names: ", ".join(_name(mac, names) for mac in r["alternates"]) or "-",
    },
    "topology": {
        "FROM": lambda r, names: _name(r["sender"], names),
        "TO": lambda r, names: _name(r["receiver"], names),
        "LOSS": lambda r, _: _figure(r["loss_ratio"], " %", 100),
        "SNR": lambda r, _: _figure(r["snr_db"], " dB"),
        "COST": lambda r, _: _figure(r["cost"], "", digits=3),
        "AGE": lambda r, _: _figure(r["age_s"], " s"),
    },
}


def dot(word: str, told: Row) -> str:
    """The same for Graphviz: the links that are known, or where frames of this node leave to."""
    names = told.get("addresses_by_mac") or {node["mac"]: node["addresses"] for node in told.get("nodes", [])}
    edges = [_edge(*ends, names) for ends in _EDGES[word](told)]
    return "\n".join([f"digraph wnet_{word} {{", *edges, "}"])


def _edge(sender: str, receiver: str, label: str, names: Mapping[str, Sequence[str]]) -> str:
    return f'  "{_name(sender, names)}" -> "{_name(receiver, names)}" [label="{label}"];'


_EDGES: dict[str, Callable[[Row], list[tuple[str, str, str]]]] = {
    "topology": lambda told: [(e["sender"], e["receiver"], f"{e['cost']:.2f}") for e in told["edges"]],
    "links": lambda told: [
        (told["mac"], link["neighbour"], _figure(link["cost_out"], "", digits=2))
        for link in told["links"]
        if link["is_usable"]
    ],
    "routes": lambda told: [
        (route["next_hop"] if route["hops"] > 1 else told["mac"], route["destination"], f"{route['hops']} hops")
        for route in told["routes"]
    ],
}
