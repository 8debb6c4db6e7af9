"""What the core tells of a peer, and the client tells an application: one record on both ends."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PathStatus:
    """One way to a peer. ``via``: the bridge in between, empty if the peer itself is heard there.

    ``loss_ratio``: of its broadcasts, 0..1, 0 over a bridge, where nobody counts; ``rate_bps``: known beforehand, or 0.
    """

    carrier: int
    address: str
    via: str
    in_use: bool
    silent_for_s: float
    loss_ratio: float
    rate_bps: float


@dataclass(frozen=True, slots=True)
class PeerStatus:
    """A peer as applications see it. ``rate_bps`` is the estimated rate of the path in use, 0 if never measured."""

    name: str
    online: bool
    carrier: int
    address: str
    silent_for_s: float
    srtt_s: float | None
    rate_bps: float
    cwnd_bytes: int
    queue_delay_s: float
    queued_messages: int
    queued_bytes: int
    paths: tuple[PathStatus, ...] = ()
