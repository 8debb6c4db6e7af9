"""What a mesh tells its owner besides frames. Values only; ``now`` is the mesh's monotonic time in seconds.

Nodes are named by the MAC address of their mesh interface, members by their place in the list given at the start.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Count(StrEnum):
    """What a mesh counts, in frames unless said otherwise."""

    ORIGINATED = "originated"
    """From the mesh interface, to be sent."""
    RELAYED = "relayed"
    """Of other nodes, queued for one more hop; once per frame, however many next hops it has."""
    DELIVERED = "delivered"
    """To the mesh interface."""
    SENT = "sent"
    """Given out for a member."""
    SENT_BYTES = "sent_bytes"
    """Bytes of those, from the destination address on."""
    CONTROL_SENT = "control_sent"
    """HELLO, TC and probes among them."""
    CONTROL_BYTES = "control_bytes"
    """Bytes of those."""
    ACKS_SENT = "acks_sent"
    AGGREGATED = "aggregated"
    """Frames that shared a member's frame with others."""
    RETRIED = "retried"
    """Sent once more, as no acknowledgement came."""
    ALTERNATE = "alternate"
    """Sent to an alternate next hop."""
    REDUNDANT = "redundant"
    """Sent along a second, disjoint path."""
    ARP_ANSWERED = "arp_answered"
    """ARP requests answered without sending them."""
    DUPLICATE = "duplicate"
    """Received again, dropped."""
    OWN = "own"
    """This node's own frames, heard back."""
    NOT_SENT = "not_sent"
    """Refused by the kernel (counted by the edge)."""


class Drop(StrEnum):
    """Why a frame of data went no further, or a received frame was not believed."""

    NO_ROUTE = "no_route"
    """No path is known to the destination."""
    NO_MEMBER = "no_member"
    """No node listens to this multicast group."""
    NOT_ACKNOWLEDGED = "not_acknowledged"
    """All tries to the next hop failed, and there is no alternate."""
    RETURNED = "returned"
    """The only way on leads back to where the frame came from."""
    HOP_LIMIT = "hop_limit"
    QUEUE_FULL = "queue_full"
    LATE = "late"
    """Waited longer than ``queue_lifetime_s``."""
    STANDING_QUEUE = "standing_queue"
    """Went so that those behind it are not late: they have all waited longer than ``queue_target_s`` for a while."""
    OVERSIZED = "oversized"
    """Does not fit into a member's frame."""
    FOREIGN_SOURCE = "foreign_source"
    """From the mesh interface, but with another source address than its own."""
    TOO_SHORT = "too_short"
    OTHER_TYPE = "other_type"
    VERSION = "version"
    CHECK = "check"
    """The header's checksum is wrong."""
    MALFORMED = "malformed"
    STRANGER = "stranger"
    """From a member that is no neighbour yet."""
    NOT_LISTED = "not_listed"
    """A forward list that does not name this node: not for us."""
    UNSEALED = "unsealed"
    FORGED = "forged"
    UNKNOWN_KEY = "unknown_key"
    REPLAYED = "replayed"


class LinkDownReason(StrEnum):
    """How a link was noticed to be gone."""

    NOT_ACKNOWLEDGED = "not_acknowledged"
    SILENT = "silent"
    NOT_HEARD_BACK = "not_heard_back"
    """The neighbour says that it does not hear us any more."""
    RESTARTED = "restarted"


@dataclass(frozen=True, slots=True)
class LinkUp:
    """A link is usable in both directions. ``peer_mac`` is the neighbour's member."""

    now: float
    neighbour: bytes
    member: int
    peer_mac: bytes
    link_id: int


@dataclass(frozen=True, slots=True)
class LinkDown:
    """A link is no longer used."""

    now: float
    neighbour: bytes
    member: int
    peer_mac: bytes
    link_id: int
    reason: LinkDownReason


@dataclass(frozen=True, slots=True)
class RouteChanged:
    """Frames to ``destination`` leave to another next hop from now on; None: there is none. Told for destinations
    that frames were sent to."""

    now: float
    destination: bytes
    next_hop: bytes | None
    cost: float | None


@dataclass(frozen=True, slots=True)
class AlternateUsed:
    """``next_hop`` owes acknowledgements; frames to ``destination`` leave to ``alternate`` meanwhile."""

    now: float
    destination: bytes
    next_hop: bytes
    alternate: bytes


@dataclass(frozen=True, slots=True)
class FrameDropped:
    """A frame of data ended here. At most a hundred a second are told, all are counted."""

    now: float
    source: bytes
    destination: bytes
    size_bytes: int
    reason: Drop


@dataclass(frozen=True, slots=True)
class DuplicateAddress:
    """Another node uses ``mac``, this node's own or that of another node; at most one a second per address."""

    now: float
    mac: bytes
    heard_from: bytes
    """The member that it was heard from."""


Event = LinkUp | LinkDown | RouteChanged | AlternateUsed | FrameDropped | DuplicateAddress
