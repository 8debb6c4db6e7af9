"""The state of a mesh at one moment, for people and JSON. Values only; costs have no unit and depend on the metric."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LinkState:
    """A link to a neighbour. ``in`` is towards this node, ``out`` away from it; None is unknown.

    ``is_usable``: both directions work. ``cost_out`` is what the routing reckons with, None while it does not use it.
    """

    neighbour: bytes
    member: int
    peer_mac: bytes
    link_id: int
    is_usable: bool
    is_mpr: bool
    """Whether the neighbour relays this node's broadcasts."""
    heard_s: float
    """Seconds since anything came from it."""
    loss_in_ratio: float
    loss_out_ratio: float | None
    snr_in_db: float | None
    snr_out_db: float | None
    srtt_s: float | None
    quality: float
    cost_out: float | None
    rate_bps: int | None
    in_flight: int


@dataclass(frozen=True, slots=True)
class EdgeState:
    """A directed link of the topology graph, by its receiver's word. ``age_s``: seconds since the last word."""

    sender: bytes
    receiver: bytes
    link_id: int
    loss_ratio: float
    snr_db: float | None
    quality: float
    cost: float
    age_s: float


@dataclass(frozen=True, slots=True)
class NodeState:
    """A node that is known of; ``addresses`` are its IPv4 addresses of 4 bytes, ``groups`` multicast MACs."""

    mac: bytes
    epoch: int
    utilisation_ratio: float
    addresses: tuple[bytes, ...]
    groups: tuple[bytes, ...]
    is_reachable: bool


@dataclass(frozen=True, slots=True)
class RouteState:
    """How frames leave to a node; ``alternates``: loop-free next hops in the order of cost."""

    destination: bytes
    next_hop: bytes
    cost: float
    hops: int
    alternates: tuple[bytes, ...]


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything at ``now``. ``counts``: by the words of :class:`~wnet.core.events.Count` and ``Drop``."""

    now: float
    mac: bytes
    epoch: int
    links: tuple[LinkState, ...]
    nodes: tuple[NodeState, ...]
    edges: tuple[EdgeState, ...]
    routes: tuple[RouteState, ...]
    groups: tuple[bytes, ...]
    """Multicast groups of this node itself."""
    queued: tuple[int, ...]
    """Frames waiting, by urgency."""
    counts: Mapping[str, int]
