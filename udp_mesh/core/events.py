"""What a core tells its owner: deliveries, the fate of messages, peers that come and go. Values only.

``now`` is the core's monotonic time in seconds. ``peer`` is a node's name, ``all`` for a broadcast.
``message_id`` is what the publisher was told; in events of fragments and deliveries it is the id on the wire, which is
another one once a message was begun anew. Every MessageQueued for a node, not for ``all``, is followed by one
MessageAcked or MessageDropped of the same message and peer.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class DropReason(StrEnum):
    """Why a message ended without a confirmed delivery."""

    QUEUE_FULL = "queue_full"
    SUPERSEDED = "superseded"
    EXPIRED = "expired"
    LOST = "lost"
    PEER_OFFLINE = "peer_offline"
    PEER_RESTARTED = "peer_restarted"
    PURGED = "purged"
    PATH_TOO_SMALL = "path_too_small"
    """It may have arrived; the path that is left cannot carry its fragments once more."""
    STORE_FULL = "store_full"
    STORE_CORRUPTED = "store_corrupted"


class RefusalReason(StrEnum):
    """Why a message was not taken at all."""

    PEER_OFFLINE = "peer_offline"
    UNKNOWN_PEER = "unknown_peer"
    OWN_NAME = "own_name"
    TOO_LARGE = "too_large"
    BAD_TOPIC = "bad_topic"
    BAD_POLICY = "bad_policy"
    QUEUE_FULL = "queue_full"
    STORE_FULL = "store_full"
    DISK_FULL = "disk_full"
    STORE_FAILED = "store_failed"
    """The store file cannot be used; the event ``store_problem`` says why."""


class PeerUpReason(StrEnum):
    """How a peer came to be online."""

    DISCOVERED = "discovered"
    RETURNED = "returned"
    RESTARTED = "restarted"


class PeerDownReason(StrEnum):
    """Why a peer is held offline."""

    SILENT = "silent"
    BEACONS_MISSED = "beacons_missed"


@dataclass(frozen=True, slots=True)
class MessageQueued:
    """A published message waits for its turn; one event per destination."""

    now: float
    message_id: int
    topic: str
    priority: int
    size_bytes: int
    fragment_count: int
    peer: str


@dataclass(frozen=True, slots=True)
class MessageHeld:
    """The rate limit of its topic keeps a queued message back; one event per destination."""

    now: float
    message_id: int
    topic: str
    priority: int
    peer: str


@dataclass(frozen=True, slots=True)
class MessageReleased:
    """The rate limit lets a message go that it had kept back for ``held_s``; it now waits for its turn."""

    now: float
    message_id: int
    topic: str
    priority: int
    peer: str
    held_s: float


@dataclass(frozen=True, slots=True)
class _Fragment:
    """A fragment that leaves. ``message_id``: on the wire."""

    now: float
    message_id: int
    priority: int
    fragment_index: int
    packet_number: int
    peer: str


@dataclass(frozen=True, slots=True)
class FragmentSent(_Fragment):
    """A fragment was handed out for sending; only while ``Settings.trace_fragments``."""


@dataclass(frozen=True, slots=True)
class FragmentRetransmitted(_Fragment):
    """A fragment was handed out for sending again."""


@dataclass(frozen=True, slots=True)
class FragmentCopied(_Fragment):
    """A fragment was handed out once more, before anything was known of its arrival: ``redundancy`` is at work."""


@dataclass(frozen=True, slots=True)
class MessageBegunAnew:
    """The receiver has forgotten what it had of a message; it is sent from its beginning, as ``wire_id``."""

    now: float
    message_id: int
    wire_id: int
    peer: str


@dataclass(frozen=True, slots=True)
class MessageAcked:
    """The peer has received the whole message. ``latency_s``: since its publication. ``token``: the publisher's own."""

    now: float
    message_id: int
    topic: str
    priority: int
    peer: str
    latency_s: float
    token: int = 0


@dataclass(frozen=True, slots=True)
class MessageDelivered:
    """A whole message from ``source`` for the applications of this node, once per message id and epoch.

    ``flags``: ``wire.DATA_FLAG_ENVELOPE`` if the payload begins with an envelope.
    """

    now: float
    message_id: int
    topic: str
    priority: int
    source: str
    payload: bytes
    flags: int = 0


@dataclass(frozen=True, slots=True)
class MessageDropped:
    """A message of this node ended without a confirmed delivery to ``peer``. ``token``: the publisher's own.

    ``may_have_arrived``: all of it had left, so that it may have been delivered without our knowing.
    """

    now: float
    message_id: int
    topic: str
    priority: int
    size_bytes: int
    peer: str
    reason: DropReason
    token: int = 0
    may_have_arrived: bool = False


@dataclass(frozen=True, slots=True)
class MessageStored:
    """A message is safe in this node's store; ``sequence`` is its number there. One event per destination."""

    now: float
    sequence: int
    topic: str
    priority: int
    size_bytes: int
    peer: str


@dataclass(frozen=True, slots=True)
class MessageConfirmed:
    """A stored message is safe in its receiver's store. ``latency_s``: since it was published or this node started."""

    now: float
    sequence: int
    topic: str
    priority: int
    peer: str
    latency_s: float


@dataclass(frozen=True, slots=True)
class StoredDropped:
    """A stored message ended without a confirmation. ``may_have_arrived``: the transport had been given it."""

    now: float
    sequence: int
    topic: str
    priority: int
    size_bytes: int
    peer: str
    reason: DropReason
    may_have_arrived: bool = False


@dataclass(frozen=True, slots=True)
class StoreProblem:
    """The store file could not be read or written. ``detail`` says what was done about it."""

    now: float
    reason: str
    detail: str


@dataclass(frozen=True, slots=True)
class PartialPurged:
    """What had arrived of a message was forgotten. ``is_settled``: its sender gave it up first."""

    now: float
    message_id: int
    source: str
    fragments_received: int
    fragment_count: int
    is_settled: bool


@dataclass(frozen=True, slots=True)
class PeerUp:
    """A peer is online."""

    now: float
    peer: str
    epoch: int
    address: str
    reason: PeerUpReason


@dataclass(frozen=True, slots=True)
class PeerDown:
    """A peer is offline."""

    now: float
    peer: str
    epoch: int
    reason: PeerDownReason


@dataclass(frozen=True, slots=True)
class PathChanged:
    """Datagrams to a peer leave by another carrier or to another address from now on."""

    now: float
    peer: str
    carrier_from: int
    address_from: str
    carrier_to: int
    address_to: str


@dataclass(frozen=True, slots=True)
class NameConflict:
    """Another node uses a name that is taken: this node's own, or a peer's whose earlier holder still sends."""

    now: float
    peer: str
    address: str


@dataclass(frozen=True, slots=True)
class Window:
    """State of the flow to a peer, at most ten times a second. ``queue_delay_s``: estimate, forward path."""

    now: float
    peer: str
    cwnd_bytes: int
    in_flight_bytes: int
    srtt_s: float
    queue_delay_s: float
    rate_bps: float


Event = (
    MessageQueued
    | MessageHeld
    | MessageReleased
    | FragmentSent
    | FragmentRetransmitted
    | FragmentCopied
    | MessageBegunAnew
    | MessageAcked
    | MessageDelivered
    | MessageDropped
    | MessageStored
    | MessageConfirmed
    | StoredDropped
    | StoreProblem
    | PartialPurged
    | PeerUp
    | PeerDown
    | PathChanged
    | NameConflict
    | Window
)
