"""The topology graph: nodes and directed links with their attributes and ages, as HELLO and TC have told them.

A link is told by its receiver. It is used only if both ends tell one for its direction: so a link of which one end has
noticed the loss is out at once, and a node that vanished leaves no trace although its last word is kept for a while.
``version`` changes whenever anything does that paths depend on.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from wnet.config import MeshConfig
from wnet.core.quality import link_cost, link_quality
from wnet.core.wire_control import Attributes, Incoming, NodeInfo, Topology

MAX_NODES = 1024
MAX_LINKS = 256
"""Links towards one node that are kept."""
_HOLD_INTERVALS = 3.5
_OWNERS_MAX = 4096
_FORMER_EPOCHS = 4
_HALF = 1 << 31


@dataclass(frozen=True, slots=True)
class Edge:
    """A directed link towards the node that holds it. ``stamp``: when it was told last."""

    link_id: int
    attributes: Attributes
    stamp: float


@dataclass(slots=True)
class Node:
    """What is known of a node. ``tail``: its last TC as it travels, for neighbours that lack it; None before."""

    mac: bytes
    epoch: int = 0
    sequence: int = 0
    tail: bytes | None = None
    info: NodeInfo = field(default_factory=NodeInfo)
    incoming: dict[bytes, Edge] = field(default_factory=dict)
    has_spoken: bool = False
    """Whether its links are by its own word; else by a neighbour's."""
    told_at: float = 0.0
    """When that TC left its origin, by this node's clock."""
    came_at: float = 0.0
    """When it came here."""
    is_relayed: bool = False
    """Whether this node has sent it on."""
    expires: float = 0.0
    former_epochs: tuple[int, ...] = ()


class TopologyGraph:
    """All that is known of the mesh. Bounded: 1024 nodes with 256 links each."""

    def __init__(self, mac: bytes, config: MeshConfig, *, epoch: int) -> None:
        self._config = config
        self.own = Node(mac, epoch=epoch, has_spoken=True, expires=float("inf"))
        self.nodes: dict[bytes, Node] = {mac: self.own}
        #: IPv4 addresses and who told them last. Those of nodes that are away stay: a host whose question nobody
        #: answers asks once a second (RFC 1122, 2.3.2.1), and would wait for that long when the other is back.
        self.owners: dict[bytes, bytes] = {}
        self.version = 0
        self.digest = 0
        self.next_expiry = float("inf")
        """When :meth:`expire` may have something to do, not before."""
        self._adjacency: dict[bytes, dict[bytes, float]] | None = None

    # -- what is told ------------------------------------------------------------------------------------------------

    def set_own_links(self, links: dict[bytes, tuple[int, Attributes]], *, now: float) -> None:
        """Set this node's usable incoming links."""
        self._set_links(self.own, {mac: Edge(link_id, told, now) for mac, (link_id, told) in links.items()})

    def set_own_info(self, info: NodeInfo) -> None:
        """Set what this node tells of itself."""
        self._set_info(self.own, info)

    def update_neighbour(
        self,
        mac: bytes,
        epoch: int,
        info: NodeInfo,
        links: dict[bytes, tuple[int, Attributes]] | None,
        *,
        hold_s: float,
        now: float,
    ) -> None:
        """Take what a neighbour's HELLO tells of itself: usable incoming links by node, None if it is partial."""
        node = self._node(mac)
        if node is None:
            return
        self._renew(node, epoch)
        self._keep(node, max(node.expires, now + hold_s))
        self._set_info(node, info)
        if links is not None:
            node.has_spoken = True
            self._set_links(node, {sender: Edge(link_id, told, now) for sender, (link_id, told) in links.items()})

    def update_edge(self, sender: bytes, receiver: bytes, link_id: int, told: Attributes, *, now: float) -> None:
        """Take the newest word on one link towards a neighbour."""
        node = self.nodes.get(receiver)
        if node is not None and node is not self.own:
            self._set_links(node, {**node.incoming, sender: Edge(link_id, told, now)})

    def suppose(self, sender: bytes, receiver: bytes, told: Attributes, *, hold_s: float, now: float) -> None:
        """Take a neighbour's word on how a third node hears it; that node's own word counts more."""
        node = self._node(receiver)
        if node is None or node.has_spoken:
            return
        self._keep(node, max(node.expires, now + hold_s))
        self._set_links(node, {**node.incoming, sender: Edge(0, told, now)})

    def is_newer(self, mac: bytes, epoch: int, sequence: int) -> bool:
        """Whether a TC tells more than what is known."""
        node = self.nodes.get(mac)
        if node is None or node.tail is None:
            return True
        if epoch == node.epoch:
            return 0 < (sequence - node.sequence) % (1 << 32) < _HALF
        return epoch not in node.former_epochs

    def update(self, topology: Topology, epoch: int, sequence: int, tail: bytes, *, age_s: float, now: float) -> bool:
        """Take a TC that :meth:`is_newer`; return whether it found a place. One that is as old as what is forgotten
        does not: else neighbours would tell each other for ever of nodes that are no more."""
        hold_s = _HOLD_INTERVALS * topology.interval_s - age_s
        node = self._node(topology.node) if hold_s > 0.0 else None
        if node is None:
            return False
        self._renew(node, epoch)
        self.digest ^= _digest_of(node)
        node.sequence, node.tail = sequence, tail
        self.digest ^= _digest_of(node)
        node.told_at, node.came_at, node.is_relayed = now - age_s, now, False
        self._keep(node, now + hold_s)
        node.has_spoken = True
        self._set_info(node, topology.info)
        self._set_links(node, {link.node: Edge(link.link_id, link.attributes, now) for link in topology.links})
        return True

    def note_own_tc(self, sequence: int, tail: bytes, *, now: float) -> None:
        """Remember this node's own TC."""
        self.own.told_at = self.own.came_at = now
        self.digest ^= _digest_of(self.own)
        self.own.sequence, self.own.tail = sequence, tail
        self.digest ^= _digest_of(self.own)

    def is_former(self, mac: bytes, epoch: int) -> bool:
        """Whether a node has had this epoch before its present one."""
        node = self.nodes.get(mac)
        return node is not None and epoch in node.former_epochs

    def expire(self, *, now: float) -> None:
        """Forget nodes of which nothing was heard for long."""
        for node in [node for node in self.nodes.values() if node.expires <= now]:
            del self.nodes[node.mac]
            self.digest ^= _digest_of(node)
            self.changed()
        self.next_expiry = min(node.expires for node in self.nodes.values())

    def _keep(self, node: Node, until: float) -> None:
        node.expires = until
        self.next_expiry = min(self.next_expiry, until)

    # -- what follows ------------------------------------------------------------------------------------------------

    def senders_to(self, receiver: bytes) -> dict[bytes, float]:
        """Return who reaches ``receiver`` over one usable link, and at what cost."""
        if self._adjacency is None:
            self._adjacency = {}
        known = self._adjacency.get(receiver)
        if known is None:
            known = self._adjacency[receiver] = dict(self._usable(receiver))
        return known

    def cost(self, sender: bytes, receiver: bytes) -> float | None:
        """Return what a usable link costs, None if there is none."""
        return self.senders_to(receiver).get(sender)

    def quality(self, sender: bytes, receiver: bytes, attributes: Attributes) -> float:
        """Return the quality of a link with these attributes, from the utilisations of its ends."""
        ends = [self.nodes[mac].info.utilisation_ratio if mac in self.nodes else 0.0 for mac in (sender, receiver)]
        return link_quality(attributes, ends[0], ends[1], self._config)

    def _usable(self, receiver: bytes) -> Iterable[tuple[bytes, float]]:
        node = self.nodes.get(receiver)
        for mac, edge in node.incoming.items() if node else ():
            sender = self.nodes.get(mac)
            back = None if sender is None else sender.incoming.get(receiver)
            if back is not None:
                quality = self.quality(mac, receiver, edge.attributes)
                yield mac, link_cost(edge.attributes, back.attributes, quality, self._config.metric)

    def _node(self, mac: bytes) -> Node | None:
        node = self.nodes.get(mac)
        if node is None and len(self.nodes) < MAX_NODES:
            node = self.nodes[mac] = Node(mac)
        return None if node is self.own else node

    def _renew(self, node: Node, epoch: int) -> None:
        if epoch == node.epoch:
            return
        if node.tail is not None or node.has_spoken:
            node.former_epochs = (node.epoch, *node.former_epochs)[:_FORMER_EPOCHS]
        self.digest ^= _digest_of(node)
        node.epoch, node.sequence, node.tail = epoch, 0, None

    def _set_info(self, node: Node, info: NodeInfo) -> None:
        if info == node.info:
            return
        if self._config.utilisation_weight > 0 or info.groups != node.info.groups:
            self.changed()
        for address in info.addresses:
            self.owners.pop(address, None)
            self.owners[address] = node.mac
        while len(self.owners) > _OWNERS_MAX:
            del self.owners[next(iter(self.owners))]
        node.info = info

    def _set_links(self, node: Node, edges: dict[bytes, Edge]) -> None:
        if len(edges) > MAX_LINKS:
            edges = dict(list(edges.items())[:MAX_LINKS])
        if {mac: edge.attributes for mac, edge in node.incoming.items()} != {
            mac: edge.attributes for mac, edge in edges.items()
        }:
            self.changed()
        node.incoming = edges

    def changed(self) -> None:
        """Have paths computed anew."""
        self.version += 1
        self._adjacency = None


def _digest_of(node: Node) -> int:
    if node.tail is None:
        return 0
    return hash_32(node.mac, node.epoch, node.sequence)


def hash_32(mac: bytes, epoch: int, sequence: int) -> int:
    """Return 32 bits that differ, most likely, between TCs; the same on every node."""
    mixed = int.from_bytes(mac, "big") * 0x9E3779B97F4A7C15 ^ epoch * 0xC2B2AE3D27D4EB4F ^ sequence * 0x165667B19E3779F9
    return (mixed ^ mixed >> 29 ^ mixed >> 43) & 0xFFFFFFFF


def incoming_of(node: Node) -> tuple[Incoming, ...]:
    """Return a node's links as a TC tells them."""
    return tuple(Incoming(mac, edge.link_id, edge.attributes) for mac, edge in node.incoming.items())
