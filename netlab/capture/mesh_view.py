"""What the daemons of a layer-2 mesh know, as their events tell it: links with qualities, next hops in use. Pure.

``links`` (about once a second, when changed) is a node's own view of its usable links, ``route_changed`` where its
frames to a destination leave to. Nodes are named by MAC addresses there, and learn their names here. Records that make
no sense are left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

_DESTINATIONS_MAX = 1024  # of one node; as many as a mesh has nodes


@dataclass(frozen=True, slots=True)
class MeshLink:
    """A link as its sender knows it; None is unknown. ``cost`` has no unit: it depends on the mesh's metric."""

    quality: float
    cost: float | None
    loss_ratio: float | None
    snr_db: float | None
    rate_bps: float | None


@dataclass(frozen=True, slots=True)
class Hop:
    """A directed link between nodes, by their names; ``destinations``: whom the sender sends frames to over it."""

    sender: str
    receiver: str
    link: MeshLink
    destinations: tuple[str, ...]


class MeshNode:
    """What one start of a node's daemon has told."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.mac = ""
        #: By the neighbour's MAC; of several members the best.
        self.links: dict[str, MeshLink] = {}
        #: By the destination's MAC.
        self.next_hops: dict[str, str] = {}

    def take(self, record: Mapping[str, object]) -> bool:
        """Take note of an event; returns whether it changed anything."""
        match record.get("event"):
            case "links":
                return self._take_links(record)
            case "route_changed":
                return self._take_route(record.get("destination"), record.get("next_hop"))
        return False

    def _take_links(self, record: Mapping[str, object]) -> bool:
        mac, rows = record.get("mac"), record.get("links")
        if not isinstance(mac, str) or not isinstance(rows, list):
            return False
        found: dict[str, MeshLink] = {}
        for row in rows:
            neighbour = row.get("neighbour") if isinstance(row, dict) else None
            if isinstance(neighbour, str):
                link = _link(row)
                if neighbour not in found or link.quality > found[neighbour].quality:
                    found[neighbour] = link
        changed = (mac, found) != (self.mac, self.links)
        self.mac, self.links = mac, found
        return changed

    def _take_route(self, destination: object, next_hop: object) -> bool:
        if not isinstance(destination, str):
            return False
        before = self.next_hops.pop(destination, None)
        if isinstance(next_hop, str) and len(self.next_hops) < _DESTINATIONS_MAX:
            self.next_hops[destination] = next_hop
        return self.next_hops.get(destination) != before


class MeshView:
    """All nodes of a lab. ``version`` is another one after every change."""

    def __init__(self) -> None:
        self.version = 0
        self._nodes: dict[str, MeshNode] = {}

    def begin(self, name: str) -> MeshNode:
        """A node's daemon has started; what an earlier one told is void."""
        self.version += 1
        node = self._nodes[name] = MeshNode(name)
        return node

    def take(self, node: MeshNode, record: Mapping[str, object]) -> None:
        """Take note of an event of that daemon."""
        self.version += node.take(record)

    def end(self, node: MeshNode) -> None:
        """That daemon is gone, unless another one has begun in its place."""
        if self._nodes.get(node.name) is node:
            self.version += 1
            del self._nodes[node.name]

    def hops(self) -> Iterator[Hop]:
        """All links whose both ends are known, by sender and receiver."""
        names = {node.mac: node.name for node in self._nodes.values()}
        for _, node in sorted(self._nodes.items()):
            leaving: dict[str, list[str]] = {}
            for destination, next_hop in node.next_hops.items():
                leaving.setdefault(next_hop, []).append(names.get(destination, destination))
            for mac, link in sorted(node.links.items()):
                if mac in names:
                    yield Hop(node.name, names[mac], link, tuple(sorted(leaving.get(mac, ()))))


def _link(row: Mapping[str, object]) -> MeshLink:
    figures = [_number(row.get(key)) for key in ("cost", "loss_ratio", "snr_db", "rate_bps")]
    return MeshLink(min(max(_number(row.get("quality")) or 0.0, 0.0), 1.0), *figures)


def _number(value: object) -> float | None:
    try:
        return float(value) if isinstance(value, int | float) else None
    except OverflowError:  # JSON has integers of any size
        return None
