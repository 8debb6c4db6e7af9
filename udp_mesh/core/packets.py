"""What a decoded datagram is made of: values only. Their bytes are the business of :mod:`udp_mesh.core.wire`."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class BadDatagram(StrEnum):
    """Why a datagram was dropped before anything in it was believed."""

    FOREIGN = "foreign"
    VERSION = "unknown_version"
    FLAGS = "unknown_flags"
    TRUNCATED = "truncated"
    FRAME = "unknown_frame"
    VALUE = "impossible_value"
    SEALED = "sealed"
    UNSEALED = "unsealed"
    UNKNOWN_KEY = "unknown_key"
    FORGED = "forged"
    REPLAYED = "replayed"
    UNPROVEN = "unproven_epoch"


class DataFragment(NamedTuple):
    """One piece of a message. ``topic`` is None except in fragment 0. ``payload`` is a view into the datagram.

    ``flags`` are the message's, the same in every fragment: ``wire.DATA_FLAG_ENVELOPE`` or nothing.
    """

    message_id: int
    priority: int
    topic: str | None
    fragment_index: int
    fragment_count: int
    payload: memoryview
    flags: int = 0


class Ack(NamedTuple):
    """What the sender of this frame has received.

    ``ranges`` are inclusive (first, last) packet numbers, newest first. ``received_us`` is when ``ranges[0][1]``
    arrived, on the acknowledging node's own clock modulo 2**32 microseconds; ``delay_us`` how long the frame waited.
    """

    ranges: tuple[tuple[int, int], ...]
    received_us: int
    delay_us: int

    @property
    def largest(self) -> int:
        """The newest acknowledged packet number."""
        return self.ranges[0][1]


class Hello(NamedTuple):
    """A beacon, or the answer to a probe: who sends with this epoch. ``heard`` are tags of nodes it answers."""

    name: str
    beacon_interval_s: float
    floor: int
    heard: tuple[int, ...]


class Link(NamedTuple):
    """What a bridge says of one of its carriers: datagrams for these ``tags`` may be sent to the bridge.

    ``number`` tells the carrier from its others; ``mtu_bytes`` is the longest datagram there, ``rate_bps`` what it
    carries (0: unknown). Within ``rounds`` such frames every tag is named.
    """

    number: int
    mtu_bytes: int
    rate_bps: int
    rounds: int
    tags: tuple[int, ...]


class Dissection(NamedTuple):
    """One datagram, decoded.

    ``destination_tag`` is the low half of the addressee's epoch, 0 in a broadcast. ``probes`` are the tags of nodes
    that the sender is looking for. ``floors``: every message below this id is settled. ``purged``: messages of which
    the sender has forgotten what it had. ``backlogs`` are priorities of what waits at the sender. ``is_bridged``: a
    bridge has passed it on. ``links``: whom else the sender, a bridge, reaches. ``ack_now``: it is to be acknowledged
    at once; ``ack_later``: that may wait for packets that follow.
    """

    epoch: int
    destination_tag: int
    packet_number: int
    is_unnumbered: bool
    ack_now: bool
    fragments: tuple[DataFragment, ...]
    acks: tuple[Ack, ...]
    beacons: tuple[Hello, ...]
    probes: tuple[int, ...]
    floors: tuple[int, ...]
    purged: tuple[int, ...]
    pings: int
    backlogs: tuple[int, ...] = ()
    is_bridged: bool = False
    links: tuple[Link, ...] = ()
    ack_later: bool = False

    @property
    def is_broadcast(self) -> bool:
        """Whether it is meant for everybody on the carrier."""
        return self.is_unnumbered and self.destination_tag == 0

    @property
    def is_ack_eliciting(self) -> bool:
        """Whether the receiver acknowledges this packet: a unicast with data or a ping."""
        return not self.is_unnumbered and bool(self.fragments or self.pings)
