"""What can be set: the values that the core obeys. Reading them from a file belongs to :mod:`udp_mesh.config`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType

from udp_mesh.core.wire import SEAL_BYTES

BROADCAST_NAME = "all"
MAX_MESSAGE_BYTES = 16 * 1024 * 1024
MAX_REDUNDANCY = 8


class Reliability(StrEnum):
    """Whether lost fragments are sent again."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Keep(StrEnum):
    """Whether a newer message of a topic replaces an older one that has not begun to be sent."""

    ALL = "all"
    LATEST = "latest"


class Offline(StrEnum):
    """What happens to a message published while its destination is offline."""

    DISCARD = "discard"
    LATEST = "latest"
    STORE = "store"
    """Kept in a file by the owner of the core (:mod:`udp_mesh.io.durable`); the core itself treats it as discard."""


@dataclass(frozen=True, slots=True)
class TopicPolicy:
    """How messages of one topic travel. ``priority``: 0..255, lower is more urgent. ``lifetime_s``: None is forever.

    ``rate_limit_hz``, ``rate_limit_bps``: at most so many messages, and bits of payload over all destinations, leave
    per second; 0 is no limit. What exceeds it waits. ``compress``: zstd, by the owner of the core.
    ``redundancy``: how many times each fragment leaves, 1..8, some milliseconds apart, only until its arrival is known.
    """

    priority: int = 5
    reliability: Reliability = Reliability.RELIABLE
    keep: Keep = Keep.ALL
    lifetime_s: float | None = None
    offline: Offline = Offline.DISCARD
    rate_limit_hz: float = 0.0
    rate_limit_bps: float = 0.0
    redundancy: int = 1
    compress: bool = False

    @property
    def is_limited(self) -> bool:
        """Whether there is a rate limit."""
        return self.rate_limit_hz > 0 or self.rate_limit_bps > 0


@dataclass(frozen=True, slots=True)
class Settings:
    """One node's settings; every field may change at run time through ``MeshCore.reconfigure`` except ``name``."""

    name: str
    payload_bytes: int = 1400
    """Largest datagram, without IP and UDP headers."""
    keys: tuple[bytes, ...] = ()
    """The team's keys of 32 bytes: the first seals, all open. None: datagrams are neither encrypted nor checked."""
    bridge: bool = False
    """Whether this node passes on between its carriers what nodes send that cannot hear each other."""
    window: int = 0
    """Packets in flight to one peer; 0 leaves it to congestion control."""
    prioritise: bool = True
    """False sends messages in the order of their publication."""
    probe: bool = True
    """False leaves the return of an offline peer to its beacons."""
    beacon_interval_s: float = 1.0
    """Least time between beacons of a settled node; a large team or a slow channel makes it longer."""
    beacon_share: float = 0.01
    """Part of the channel's time that the beacons and answers of the whole team may take."""
    channel_bps: float = 6e6
    """Rate of broadcasts on the channel that the team shares; for shares only, nothing is paced by it."""
    shared_bps: float = 0.0
    """Rate of unicasts on a channel that the whole team shares, for ``coordinate``; 0: unknown, or none is shared."""
    queue_bytes: int = 16 * 1024 * 1024
    """Payload waiting or in flight in this node, over all destinations."""
    floor_ratio: float = 0.0
    """Share of what leaves that less urgent messages get although more urgent ones wait, 0..0.5."""
    coordinate: bool = False
    """Whether this node announces what waits here, and yields to neighbours with something more urgent."""
    queue_messages: int = 4096
    """Messages of one topic waiting or in flight in this node."""
    reassembly_bytes: int = 64 * 1024 * 1024
    """Memory reserved for partial messages from all peers."""
    suspect_after_s: float = 0.5
    """Silence of a peer that owes an answer before it counts as offline."""
    trace_fragments: bool = False
    """Whether every fragment sent becomes an event."""
    topics: Mapping[str, TopicPolicy] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def packet_bytes(self) -> int:
        """Largest datagram as the core builds it, before it is sealed."""
        return self.payload_bytes - (SEAL_BYTES if self.keys else 0)

    def policy(self, topic: str) -> TopicPolicy:
        """Return the policy of a topic, the default one if the topic is not listed."""
        return self.topics.get(topic, _DEFAULT_POLICY)


_DEFAULT_POLICY = TopicPolicy()
